"""Polycam's raw export: `keyframes/images`, `keyframes/depth` and `keyframes/cameras`, a JSON file for each frame.

A folder that holds what lies in `keyframes` is read as well. Cameras look along -z with y up, in a world whose y points
up (ARKit). Where Polycam has refined the poses, there are `corrected_images` and `corrected_cameras` as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.phones.arkit import ARKIT_DOWN, confidence_files, pose_of_arkit
from app.importers.scan_camera import camera_stated_in
from app.importers.unpacked import FrameFiles
from app.importers.unread.exports import lacking

DEFAULT_DEPTH_SCALE = 1000.0
MICROSECONDS_PER_S = 1e6
_PARENT = "keyframes/"
_DEPTH = "depth"
_CAMERAS = ("corrected_cameras", "cameras")
_IMAGES = ("corrected_images", "images")
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


def detect(directory: Path) -> bool:
    """Return whether the folder, or its folder `keyframes`, holds `cameras` or its corrected form."""
    return any((directory / _PARENT / name).is_dir() for name in _CAMERAS) or _is_keyframes(directory)


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a raw export, its corrected poses and images if there are any.

    Depth is that of the colour picture resampled, in 1000 per metre, without what the export's confidence says to be
    low; a phone without LiDAR records none. Gravity is the world's -y, as ARKit measures it. Raises `InvalidScanError`
    for files that are missing or not this.
    """
    folder, files, discarded = ScanFolder(directory), FrameFiles(options.scratch), Discarded()
    parent = "" if _is_keyframes(directory) else _PARENT
    cameras, images = _folders(folder, parent)
    found = _json_files(folder, cameras)
    if not found:
        raise lacking("polycam", f"{cameras} with its .json files", "the camera poses")
    entries = {path.stem: read_json_object(path) for path in found}
    depths = directory / parent / _DEPTH
    has_depth = depths.is_dir() and bool(folder.files_in(depths))
    confidence = confidence_files(folder, f"{parent}{_DEPTH}", f"{parent}confidence")
    frames = _frames(folder, entries, images, f"{parent}{_DEPTH}" if has_depth else None, discarded)
    own = [_camera(entries[frame.color.stem], frame) for frame in frames] if options.camera is None else []
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=ARKIT_DOWN,
        confidence=confidence,
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, own, discarded, source, options, files=files)


def _json_files(folder: ScanFolder, cameras: str) -> list[Path]:
    files = folder.files_in(folder.path / cameras)
    found = (
        folder.find(folder.name_of(path), "the scan") for path in files if path.suffix.lower() == ".json"
    )
    return [path for path in found if path is not None]


def _folders(folder: ScanFolder, parent: str) -> tuple[str, str]:
    """Return the folders of cameras and pictures: the corrected ones unless most of them are missing."""
    pairs = [
        (f"{parent}{cameras}", f"{parent}{images}")
        for cameras, images in (*zip(_CAMERAS, _IMAGES, strict=True), (_CAMERAS[0], _IMAGES[1]))
    ]
    counts = [_complete(folder, *pair) for pair in pairs]
    if counts[0] and 2 * counts[0] >= counts[1]:
        return pairs[0]
    return next((pair for pair, count in zip(pairs[1:], counts[1:], strict=True) if count), pairs[1])


def _complete(folder: ScanFolder, cameras: str, images: str) -> int:
    """Return how many cameras have a picture."""
    pictures = {path.stem for path in folder.files_in(folder.path / images)}
    return sum(path.stem in pictures for path in _json_files(folder, cameras))


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


def _camera(entry: dict[str, Any], frame: Frame) -> Camera | None:
    """Return the camera of a frame for the size that the export states, else that of the picture, as new versions of
    the app state none; None for a picture that can't be read."""
    name, size = f"{frame.color.stem}.json", color_size(frame.color)
    values = tuple(number_of(entry, key, name) for key in ("fx", "fy", "cx", "cy"))
    if "width" in entry and "height" in entry:
        size = int(number_of(entry, "width", name)), int(number_of(entry, "height", name))
    with camera_stated_in(name):
        return None if size is None else Camera("PINHOLE", *size, values)


def _frames(
    folder: ScanFolder,
    entries: dict[str, dict[str, Any]],
    images: str,
    depths: str | None,
    discarded: Discarded,
) -> list[Frame]:
    """Return the frames; in a scan without depth a frame's picture stands for it."""
    frames, invalid = [], []
    for stem, entry in entries.items():
        found = (folder.find(f"{images}/{stem}{suffix}", "the scan") for suffix in _IMAGE_SUFFIXES)
        color = next(filter(None, found), None)
        depth = color if depths is None else folder.find(f"{depths}/{stem}.png", "the scan")
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
