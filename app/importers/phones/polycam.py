"""Polycam's raw export: `keyframes/images`, `keyframes/depth` and `keyframes/cameras`, a JSON file for each frame.

A folder that holds what lies in `keyframes` is read as well. Cameras look along -z with y up, in a world whose y points
up (ARKit). Where Polycam has refined the poses, there are `corrected_images` and `corrected_cameras` as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidCameraError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.cameras import common_intrinsics
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.phones.arkit import ARKIT_DOWN, confidence_files, pose_of_arkit

DEFAULT_DEPTH_SCALE = 1000.0
MICROSECONDS_PER_S = 1e6
_PARENT = "keyframes/"
_CAMERAS = ("corrected_cameras", "cameras")
_IMAGES = ("corrected_images", "images")
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


def detect(directory: Path) -> bool:
    """Return whether the folder, or its folder `keyframes`, holds `cameras` or its corrected form."""
    return any((directory / _PARENT / name).is_dir() for name in _CAMERAS) or _is_keyframes(directory)


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a raw export, its corrected poses and images if there are any.

    Depth is that of the colour picture resampled, in 1000 per metre, without what the export's confidence says to be
    low. Gravity is the world's -y, as ARKit measures it. Raises `InvalidScanError` for files that are missing or not
    this.
    """
    folder = ScanFolder(directory)
    parent = "" if _is_keyframes(directory) else _PARENT
    corrected = all((directory / parent / name).is_dir() for name in (_CAMERAS[0], _IMAGES[0]))
    cameras, images = (f"{parent}{names[0 if corrected else 1]}" for names in (_CAMERAS, _IMAGES))
    files = [path for path in folder.files_in(directory / cameras) if path.suffix.lower() == ".json"]
    if not files:
        raise InvalidScanError(f"The scan has no camera poses: {cameras} holds no .json file.")
    found = [folder.find(folder.name_of(path), "the scan") for path in files]
    entries = {path.stem: read_json_object(path) for path in found if path is not None}
    discarded = Discarded()
    source = ScanSource(
        camera=options.camera or hint_of(_camera(entries)),
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=ARKIT_DOWN,
        confidence=confidence_files(folder, f"{parent}depth", f"{parent}confidence"),
    )
    frames = _frames(folder, entries, images, f"{parent}depth", discarded)
    return assemble_scan(frames, discarded, source, options)


def _is_keyframes(directory: Path) -> bool:
    """Return whether a folder is what a raw export calls `keyframes`: other tools have folders `cameras` too."""
    if not any((directory / name).is_dir() for name in _IMAGES):
        return False
    entries = (path for name in _CAMERAS for path in (directory / name).glob("*.json"))
    first = next(entries, None)
    if first is None:
        return False
    try:
        return all(key in read_json_object(first) for key in ("t_00", "t_23"))
    except InvalidScanError:
        return False


def _camera(entries: dict[str, dict[str, Any]]) -> Camera:
    names = [f"{stem}.json" for stem in entries]
    each = [
        tuple(number_of(entry, key, name) for key in ("fx", "fy", "cx", "cy"))
        for entry, name in zip(entries.values(), names, strict=True)
    ]
    first = next(iter(entries.values()))
    width, height = (int(number_of(first, key, names[0])) for key in ("width", "height"))
    try:
        return Camera("PINHOLE", width, height, common_intrinsics(each, names))
    except InvalidCameraError as error:
        raise InvalidScanError(f"{names[0]}: {error}") from None


def _frames(
    folder: ScanFolder, entries: dict[str, dict[str, Any]], images: str, depths: str, discarded: Discarded
) -> list[Frame]:
    frames, invalid = [], []
    for stem, entry in entries.items():
        found = (folder.find(f"{images}/{stem}{suffix}", "the scan") for suffix in _IMAGE_SUFFIXES)
        color = next(filter(None, found), None)
        depth = folder.find(f"{depths}/{stem}.png", "the scan")
        name = f"{images}/{stem}.jpg" if color is None else folder.name_of(color)
        pose = _pose(entry, f"{stem}.json")
        if color is None:
            discarded.add("missing_file", name, f"{name} is missing; {folder.instead(name)}")
        elif depth is None:
            missing = f"{depths}/{stem}.png"
            discarded.add("no_depth", name, f"{missing} is missing; {folder.instead(missing)}")
        elif pose is None:
            discarded.add("invalid_pose", name)
            invalid.append(name)
        else:
            frames.append(Frame(name, _time_s(entry, stem), color, depth, pose))
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _time_s(entry: dict[str, Any], stem: str) -> float:
    return (
        number_of({"timestamp": float(stem), **entry} if stem.isdigit() else entry, "timestamp", stem)
        / MICROSECONDS_PER_S
    )


def _pose(entry: dict[str, Any], where: str) -> Pose | None:
    values = [number_of(entry, f"t_{row}{column}", where) for row in range(3) for column in range(4)]
    return pose_of_arkit(np.vstack([np.array(values).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]))
