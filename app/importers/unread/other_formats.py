"""Scans that are recognised and not read: what each is, and what to do with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from app.importers.unread.exports import EXPORTS
from app.importers.unread.single_files import ARCHIVE_SUFFIXES, MAKERS_SUFFIXES, MODELS, describe_model

TO_TUM = (
    "write a TUM scan: rgb.txt and depth.txt (timestamp file), groundtruth.txt (timestamp tx ty tz qx qy qz qw, camera "
    "to world, z forward, y down) and camera.txt."
)
PHOTOS = (".jpg", ".jpeg", ".heic")


def describe_other_format(directory: Path) -> str:
    """Return a sentence that names the format of a folder's scan and says what to do, or nothing if it isn't known."""
    names = {child.name.lower() for child in directory.iterdir() if not child.name.startswith(".")}
    sentence = next((sentence for recognise, sentence in _FORMATS if recognise(names)), "")
    return sentence or _of_archives(names) or _of_models(names) or _of_videos(names)


def _of_models(names: set[str]) -> str:
    suffix = next((suffix for suffix in MODELS if any(name.endswith(suffix) for name in names)), None)
    if suffix is None:
        return ""
    photos = any(name.endswith(PHOTOS) for name in names)
    others = ' If the pictures beside it are photos of the place, give "format": "images".' if photos else ""
    return f"{describe_model(suffix)}.{others}"


def _of_archives(names: set[str]) -> str:
    inner = sorted(name for name in names if name.endswith(tuple(ARCHIVE_SUFFIXES)))
    if not inner:
        return ""
    return (
        f"The archive holds other archives, such as {inner[0]}: unpack those first, and send one archive of their "
        "files."
    )


def _of_videos(names: set[str]) -> str:
    if not any(name.endswith((".mp4", ".mov", ".mkv", ".avi")) for name in names):
        return ""
    return 'This is a video among other files: if it alone is the scan, send it by itself or give "format": "video".'


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
        _has("pose_intrinsic_imu.json"),
        "This is the iPhone part of ScanNet++, which is not read as it is: take pictures and depth out of its video "
        "and depth.bin with the data set's own tools, then " + TO_TUM,
    ),
    (
        _has("info.json", "textured_output.obj"),
        'This is a model of the app 3D Scanner App without its pictures: export "all data" instead.',
    ),
    (
        _has("database.db"),
        f"This is a project of COLMAP without its model: {EXPORTS['colmap'].remedy}.",
    ),
    (
        _ends(".r3d", ".db"),
        "The recording is damaged, or not one of Record3D (.r3d) or RTAB-Map (.db): copy it from the phone again.",
    ),
    (
        _ends(*MAKERS_SUFFIXES),
        "This is a recording of a depth camera in its maker's format, which is not read: track it, then "
        + TO_TUM,
    ),
)
