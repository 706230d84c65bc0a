"""Scans that are recognised and not read: what each is, and what to do with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

TO_TUM = (
    "write a TUM scan: rgb.txt and depth.txt (timestamp file), groundtruth.txt (timestamp tx ty tz qx qy qz qw, camera "
    "to world, z forward, y down) and camera.txt."
)


def describe_other_format(directory: Path) -> str:
    """Return a sentence that names the format of a folder's scan and says what to do, or nothing if it isn't known."""
    names = {child.name.lower() for child in directory.iterdir()}
    return next((sentence for recognise, sentence in _FORMATS if recognise(names)), "")


def _has(*wanted: str) -> Callable[[set[str]], bool]:
    return lambda names: names.issuperset(wanted)


def _ends(*suffixes: str) -> Callable[[set[str]], bool]:
    return lambda names: any(name.endswith(suffixes) for name in names)


_FORMATS: tuple[tuple[Callable[[set[str]], bool], str], ...] = (
    (_has("mav0"), "This is a recording in the layout of EuRoC, which is not read: " + TO_TUM),
    (
        _has("results", "traj.txt"),
        "This is a scan in the layout of Replica as NICE-SLAM has it, which is not read: " + TO_TUM,
    ),
    (
        _has("info.json", "textured_output.obj"),
        'This is a model of the app 3D Scanner App without its pictures: export "all data" instead.',
    ),
    (
        _ends(".usdz", ".usdc", ".usda", ".usd"),
        "This is a USDZ, a model without the pictures that it was made from, so that no photo can be found in it. Let "
        "the app that scanned export its pictures, depth and poses (raw data) instead: Polycam, Record3D, Stray "
        "Scanner, 3D Scanner App.",
    ),
    (
        _ends(".r3d", ".db"),
        "The recording is damaged, or not one of Record3D (.r3d) or RTAB-Map (.db): copy it from the phone again.",
    ),
    (
        _ends(".klg", ".oni", ".svo", ".svo2"),
        "This is a recording of a depth camera in its maker's format, which is not read: track it, then "
        + TO_TUM,
    ),
    (
        _ends(".mp4", ".mov", ".mkv", ".avi"),
        'This is a video among other files: if it alone is the scan, send it by itself or give "format": "video".',
    ),
)
