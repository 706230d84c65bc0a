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
    (
        _has("odometry.csv", "camera_matrix.csv"),
        "This is a scan of the app Stray Scanner, which is not read, as its colour is a video. Extract the frames "
        "(ffmpeg -i rgb.mp4 rgb/%06d.png), give depth_camera for its smaller depth, and " + TO_TUM,
    ),
    (
        _ends(".sens"),
        "This is a ScanNet recording (.sens), which is not read: extract it with ScanNet's SensReader "
        "(--export_depth_images --export_color_images --export_poses --export_intrinsics) and send that folder.",
    ),
    (
        _has("lowres_depth", "lowres_wide"),
        "This is a scan of ARKitScenes, which is not read: " + TO_TUM,
    ),
    (
        _ends(".r3d"),
        "This is a recording of the app Record3D (.r3d), which is not read: export it as images and poses, then "
        + TO_TUM,
    ),
    (_has("mav0"), "This is a recording in the layout of EuRoC, which is not read: " + TO_TUM),
    (
        _has("images.txt", "cameras.txt"),
        "This is a COLMAP model, which has no depth images: a map needs a scan with depth. If there is depth, "
        + TO_TUM,
    ),
    (
        _has("results", "traj.txt"),
        "This is a scan in the layout of Replica as NICE-SLAM has it, which is not read: " + TO_TUM,
    ),
    (
        _has("info.json", "textured_output.obj"),
        "This is an export of the app 3D Scanner App, which is not read: " + TO_TUM,
    ),
    (
        _ends(".bag", ".mcap"),
        "This is a ROS recording, which is not read: extract its images and poses, then " + TO_TUM,
    ),
    (
        _ends(".db"),
        "This is a database of RTAB-Map, which is not read: export its RGB-D images and its poses (RGB-D SLAM "
        "format), then " + TO_TUM,
    ),
    (
        _ends(".klg", ".oni", ".svo", ".svo2"),
        "This is a recording of a depth camera in its maker's format, which is not read: track it, then "
        + TO_TUM,
    ),
    (
        _ends(".mp4", ".mov", ".mkv", ".avi"),
        "This is a video, which is not read: a map is made of colour images with depth and poses. Extract the frames, "
        "and " + TO_TUM,
    ),
)
