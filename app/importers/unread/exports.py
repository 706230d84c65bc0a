"""How each app and tool gives out a scan with its pictures and poses, in the words that complete a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from app.errors import InvalidScanError


@dataclass(frozen=True, slots=True)
class Export:
    """What a format is called in a sentence, and what to do to get all of its files."""

    title: str
    remedy: str


_ALL_FILES = "send all files of the scan's folder"
EXPORTS: Mapping[str, Export] = {
    "stray-scanner": Export(
        "a recording of Stray Scanner",
        "copy the whole folder of the recording from the Files app (rgb.mp4, odometry.csv, camera_matrix.csv, depth, "
        "confidence)",
    ),
    "record3d": Export(
        "a recording of Record3D",
        'in the app choose Library, Export, "Shareable internal format (.r3d)", and send that file as it is',
    ),
    "polycam": Export(
        "a raw export of Polycam",
        'switch on developer mode in the app before scanning, then choose Export, "Raw data"',
    ),
    "3d-scanner-app": Export(
        "an export of 3D Scanner App",
        'scan in the mode "LiDAR Advanced", then choose Share, "All Data"',
    ),
    "arkitscenes": Export(
        "a recording of ARKitScenes",
        "download the assets lowres_wide, lowres_wide_intrinsics, lowres_depth, confidence and lowres_wide.traj",
    ),
    "scannet": Export(
        "a scan of ScanNet",
        "export depth, colour, poses and intrinsics from its .sens file, or send the .sens file",
    ),
    "rtabmap-export": Export(
        "an export of RTAB-Map",
        "run rtabmap-export --images_id --poses_camera --poses_format 11, and send all that it writes, or send the .db",
    ),
    "kapture": Export("a data set of kapture", "send the folder sensors with its tables and records_data"),
    "colmap": Export(
        "a COLMAP model", "send cameras and images (.txt or .bin) with the folder of the pictures beside them"
    ),
    "7scenes": Export(
        "a scan of 7-Scenes",
        "each frame needs frame-000000.color.png and .pose.txt, and .depth.png where the scan has depth",
    ),
    "tum": Export("a scan in TUM layout", _ALL_FILES),
    "redwood": Export(
        "a scan of Open3D or Redwood",
        "send color, depth and the trajectory (.log, or .json of Open3D) together",
    ),
}


def lacking(name: str, part: str, what: str) -> InvalidScanError:
    """Return the error of a scan that lacks a file: its format, the file, what that holds, and what to do."""
    export = EXPORTS[name]
    return InvalidScanError(f"This is {export.title}, and {part} is missing, {what}: {export.remedy}.")
