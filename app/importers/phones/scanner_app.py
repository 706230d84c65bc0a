"""3D Scanner App, "all data": `frame_00000.json`, `frame_00000.jpg`, `depth_00000.png`, `conf_00000.png`.

The fields of the JSON files were taken from public readers of the export (github.com/pwais/psegs among them):
`cameraPoseARFrame` is a 4x4 matrix by rows with ARKit's camera axes, `intrinsics` a 3x3 matrix by rows.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.phones.arkit import ARKIT_DOWN, pose_of_arkit
from app.importers.scan_camera import camera_stated_in
from app.importers.unpacked import FrameFiles
from app.importers.unread.exports import lacking

DEFAULT_DEPTH_SCALE = 1000.0
FRAME_RATE_HZ = 60.0
_DEPTH = re.compile(r"depth_\d{1,9}\.png$", re.IGNORECASE)
_PICTURE = re.compile(r"frame_(\d{1,9})\.(?:jpe?g|png)$", re.IGNORECASE)


def detect(directory: Path) -> bool:
    """Return whether the folder holds pictures with a JSON file each."""
    names = {child.name for child in directory.iterdir()}
    pictures = (name for name in names if _PICTURE.fullmatch(name))
    return any(f"{name.rpartition('.')[0]}.json" in names for name in pictures)


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of an export; only frames with a picture are taken, the app stores one in several.

    Depth is that of the colour picture resampled, in 1000 per metre, without what has low confidence; a phone without
    LiDAR records none. Gravity is the world's -y, as ARKit measures it. Raises `InvalidScanError` for files that are
    missing or not this.
    """
    folder = ScanFolder(directory)
    pictures = [path for path in folder.files_in(directory) if _PICTURE.fullmatch(path.name)]
    if not pictures:
        raise InvalidScanError("The scan has no frame_00000.jpg and so on.")
    has_depth = any(_DEPTH.fullmatch(path.name) for path in folder.files_in(directory))
    files = FrameFiles(options.scratch)
    discarded, cameras = Discarded(), []
    frames, invalid, confidence = [], [], {}
    for picture in pictures:
        stem = picture.stem.partition("_")[2]
        path, depth, conf = (
            folder.find(name, "the scan")
            for name in (f"{picture.stem}.json", f"depth_{stem}.png", f"conf_{stem}.png")
        )
        if path is None:
            detail = f"{picture.stem}.json is missing; {folder.instead(f'{picture.stem}.json')}"
            discarded.add("no_pose", picture.name, detail)
            continue
        content = read_json_object(path)
        pose = pose_of_arkit(_numbers(content, "cameraPoseARFrame", path.name, 16).reshape(4, 4))
        depth = depth if has_depth else picture
        if depth is None:
            detail = f"depth_{stem}.png is missing; {folder.instead(f'depth_{stem}.png')}"
            discarded.add("no_depth", picture.name, detail)
        elif pose is None:
            discarded.add("invalid_pose", picture.name)
            invalid.append(picture.name)
        else:
            frames.append(Frame(picture.name, _time_s(content, stem, path.name), picture, depth, pose))
            cameras.append(_camera(content, path.name, picture))
            confidence.update({} if conf is None else {depth: conf})
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    if not frames and "no_pose" in discarded.names:
        raise lacking("3d-scanner-app", "frame_00000.json and so on", "which hold camera and pose")
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=ARKIT_DOWN,
        confidence=confidence,
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, cameras, discarded, source, options, files=files)


def _camera(content: dict[str, Any], where: str, picture: Path) -> Camera | None:
    """Return the camera of a picture, None where that can't be read."""
    K, size = _numbers(content, "intrinsics", where, 9), color_size(picture)
    with camera_stated_in(where):
        return None if size is None else Camera("PINHOLE", *size, tuple(float(K[i]) for i in (0, 4, 2, 5)))


def _time_s(content: dict[str, Any], stem: str, where: str) -> float:
    return number_of(content, "time", where) if "time" in content else int(stem) / FRAME_RATE_HZ


def _numbers(content: dict[str, Any], key: str, where: str, count: int) -> NDArray[np.float64]:
    try:
        values = np.array(content.get(key), dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(0)
    if len(values) != count:
        raise InvalidScanError(f"{where}: {key} must be {count} numbers, a matrix by rows.")
    return values
