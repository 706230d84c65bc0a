"""nerfstudio's layout: `transforms.json` with `file_path`, `depth_file_path` and `transform_matrix` of each frame.

Its cameras look along -z with y up (OpenGL), and its principal points count from the corner of the first pixel.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidCameraError, InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.cameras import common_intrinsics
from app.importers.frame_files.json_files import matrix_of, number_of, read_json_object
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.scan_files import optional_file, read_gravity
from app.importers.unpacked import WITHOUT_DEPTH, FrameFiles

FILE = "transforms.json"
DEFAULT_DEPTH_SCALE = 1000.0
# The files hold no times: frames follow each other by name.
FRAME_RATE_HZ = 30.0
# From the corner of the first pixel to its centre.
CORNER_TO_CENTRE_PX = 0.5
OPENGL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
DISTORTION = {
    "PINHOLE": (),
    "SIMPLE_PINHOLE": (),
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}
_NUMBERS = re.compile(r"(\d+)")


def detect(directory: Path) -> bool:
    """Return whether the folder holds `transforms.json`."""
    return optional_file(directory, FILE) is not None


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in nerfstudio's layout; if no frame names a depth image, one without depth.

    The frames' world is the scan's frame, without the scale that nerfstudio may have applied. Depth of another size
    than its colour image is that of the same picture resampled; integers are in 1000 per metre unless stated. Raises
    `InvalidScanError` for a file that is not this, for frames without depth and for lenses that are not known.
    """
    folder = ScanFolder(directory)
    path = optional_file(directory, FILE)
    if path is None:
        raise InvalidScanError(f"The scan has no {FILE}.")
    content = read_json_object(path)
    listed = content.get("frames")
    if not isinstance(listed, list) or not listed or not all(isinstance(frame, dict) for frame in listed):
        raise InvalidScanError(f"{FILE} lists no frames.")
    has_depth = any("depth_file_path" in frame for frame in listed)
    files, discarded = FrameFiles(options.scratch), Discarded()
    entries = sorted(listed, key=lambda frame: _natural(str(frame.get("file_path", ""))))
    scale = number_of(content, "applied_scale", FILE) if "applied_scale" in content else 1.0
    source = ScanSource(
        camera=options.camera or hint_of(_camera(content, entries)),
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        has_depth=has_depth,
        notes=() if has_depth else (WITHOUT_DEPTH,),
        keeps=files,
    )
    blank = (
        None if has_depth else files.blank_depth(*(int(number_of(content, key, FILE)) for key in ("w", "h")))
    )
    return assemble_scan(_frames(folder, entries, scale, blank, discarded), discarded, source, options)


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in _NUMBERS.split(name)]


def _camera(content: Mapping[str, Any], entries: list[dict[str, Any]]) -> Camera:
    model = str(content.get("camera_model", "OPENCV"))
    if model not in DISTORTION:
        raise InvalidScanError(
            f"{FILE}: camera_model {model!r} is not known; use one of {', '.join(DISTORTION)}."
        )
    each = [{**content, **entry} for entry in entries]
    names = [str(entry.get("file_path")) for entry in entries]
    values = common_intrinsics(
        [_intrinsics(values, model, f"{FILE}: {name}") for values, name in zip(each, names, strict=True)],
        names,
    )
    width, height = (int(number_of(each[0], key, FILE)) for key in ("w", "h"))
    # Four zeros are no lens that was measured.
    if model != "OPENCV_FISHEYE" and not any(values[4:]):
        model, values = "PINHOLE", values[:4]
    try:
        return Camera(model, width, height, values)
    except InvalidCameraError as error:
        raise InvalidScanError(f"{FILE}: {error}") from None


def _intrinsics(values: Mapping[str, Any], model: str, where: str) -> tuple[float, ...]:
    fx = number_of(values, "fl_x", where)
    fy = number_of(values, "fl_y", where) if "fl_y" in values else fx
    cx, cy = (number_of(values, key, where) - CORNER_TO_CENTRE_PX for key in ("cx", "cy"))
    lens = [number_of(values, key, where) if key in values else 0.0 for key in DISTORTION[model]]
    if model == "OPENCV" and values.get("k3"):
        raise InvalidScanError(
            f"{where}: k3 is not read; undistort the images, or give `camera` in the options."
        )
    return fx, fy, cx, cy, *lens


def _frames(
    folder: ScanFolder,
    entries: list[dict[str, Any]],
    scale: float,
    blank: Path | None,
    discarded: Discarded,
) -> list[Frame]:
    frames, invalid = [], []
    for number, entry in enumerate(entries):
        where = f"{FILE}: frame {entry.get('file_path')}"
        name, depth_name = str(entry.get("file_path", "")), str(entry.get("depth_file_path", ""))
        color = folder.find(name, where) if name else None
        depth = folder.find(depth_name, where) if depth_name else blank
        pose = _pose(entry, scale, where)
        if color is None:
            discarded.add("missing_file", name, f"{name} of {FILE}; {folder.instead(name or '?')}")
        elif not depth_name and depth is None:
            discarded.add("no_depth", name)
        elif depth is None:
            detail = f"{depth_name} of {FILE}; {folder.instead(depth_name)}"
            discarded.add("missing_file", name, detail)
        elif pose is None:
            discarded.add("invalid_pose", name)
            invalid.append(name)
        else:
            frames.append(Frame(folder.name_of(color), number / FRAME_RATE_HZ, color, depth, pose))
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _pose(entry: Mapping[str, Any], scale: float, where: str) -> Pose | None:
    matrix = matrix_of(entry.get("transform_matrix"), f"{where}: transform_matrix")
    if matrix is None:
        return None
    matrix = matrix @ OPENGL_FROM_CAMERA
    matrix[:3, 3] /= scale
    try:
        return Pose.from_matrix(matrix)
    except InvalidPoseError:
        return None
