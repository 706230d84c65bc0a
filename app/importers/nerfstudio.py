"""nerfstudio's layout: `transforms.json` with `file_path`, `depth_file_path` and `transform_matrix` of each frame.

Its cameras look along -z with y up (OpenGL), and its principal points count from the corner of the first pixel.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.json_files import matrix_of, number_of, read_json_object
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.scan_camera import camera_stated_in
from app.importers.scan_files import optional_file, read_gravity
from app.importers.unpacked import FrameFiles

FILE = "transforms.json"
# NeRF's own layout has a file for each part of the frames.
SPLIT_FILES = ("transforms_train.json", "transforms_val.json", "transforms_test.json")
DEFAULT_DEPTH_SCALE = 1000.0
# Keys of a frame's depth image, and of what an integer in it is in metres: nerfstudio's, and those of instant-ngp.
DEPTH_KEYS = ("depth_file_path", "depth_path")
DEPTH_UNIT_KEYS = ("depth_unit_scale_factor", "integer_depth_scale")
# The files hold no times: frames follow each other by name.
FRAME_RATE_HZ = 30.0
# From the corner of the first pixel to its centre.
CORNER_TO_CENTRE_PX = 0.5
OPENGL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
FISHEYE = "OPENCV_FISHEYE"
PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV", "PERSPECTIVE")
_LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE_LENS = ("k1", "k2", "k3", "k4")
# Paths may stand without these.
_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
# A path in the beginning of a list that leads out of its folder.
_LEADS_OUT = re.compile(rb'_path"\s*:\s*"(?:\./)?\.\.[/\\]')
_HEAD_BYTES = 8192
_NUMBERS = re.compile(r"(\d+)")


def detect(directory: Path) -> bool:
    """Return whether the folder holds `transforms.json`, or that of training frames alone, or has it in a folder beside
    that of the pictures."""
    return _list_folder(directory) is not None


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in nerfstudio's layout; if none of its depth images is there, one without depth.

    The frames' world is the scan's frame, without the scale that nerfstudio may have applied. Depth of another size
    than its colour image is that of the same picture resampled; integers are in 1000 per metre unless stated. Raises
    `InvalidScanError` for a file that is not this, for frames without depth and for lenses that are not known.
    """
    folder = ScanFolder(directory)
    content, listed = _content(_list_folder(directory) or directory)
    has_depth = _has_depth(folder, listed)
    files, discarded = FrameFiles(options.scratch), Discarded()
    entries = sorted(listed, key=lambda frame: _natural(str(frame.get("file_path", ""))))
    scale = number_of(content, "applied_scale", FILE) if "applied_scale" in content else 1.0
    frames, of_frames = _frames(folder, entries, scale, has_depth, discarded)
    each = [{**content, **entry} for entry in of_frames] if options.camera is None else []
    cameras = [_camera(values, frame) for values, frame in zip(each, frames, strict=False)]
    source = ScanSource(
        depth_scale=_depth_scale(content),
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, cameras, discarded, source, options, files=files)


def _list_folder(directory: Path) -> Path | None:
    """Return the folder of the list: the scan's, or the only one in it whose list names files outside of itself."""
    if any(optional_file(directory, name) is not None for name in (FILE, SPLIT_FILES[0])):
        return directory
    below = [path.parent for path in directory.glob(f"*/{FILE}") if not path.parent.is_symlink()]
    if len(below) != 1 or (below[0] / FILE).is_symlink():
        return None
    with (below[0] / FILE).open("rb") as file:
        return below[0] if _LEADS_OUT.search(file.read(_HEAD_BYTES)) else None


def _content(directory: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what the file says of all frames, and its frames; those of several files where there is one a part."""
    names = (FILE,) if optional_file(directory, FILE) is not None else SPLIT_FILES
    paths = [path for name in names if (path := optional_file(directory, name)) is not None]
    if not paths:
        raise InvalidScanError(f"The scan has no {FILE}.")
    contents = [read_json_object(path) for path in paths]
    listed = []
    for content, path in zip(contents, paths, strict=True):
        frames = content.get("frames")
        if not isinstance(frames, list) or not frames or not all(isinstance(item, dict) for item in frames):
            raise InvalidScanError(f"{path.name} lists no frames.")
        listed += frames
    return contents[0], listed


def _depth_name(entry: Mapping[str, Any]) -> str:
    return str(next((entry[key] for key in DEPTH_KEYS if entry.get(key)), ""))


def _has_depth(folder: ScanFolder, entries: list[dict[str, Any]]) -> bool:
    """Whether the list names depth images, and any of them or other depth is there."""
    named = [name for entry in entries if (name := _depth_name(entry))]
    colors = (_file(folder, str(entry.get("file_path", "")), FILE) for entry in entries)
    return bool(named) and (any(_file(folder, name, FILE) for name in named) or holds_depth(folder, colors))


def _depth_scale(content: Mapping[str, Any]) -> float | None:
    """Return the units per metre that the file states, None if it states none."""
    key = next((key for key in DEPTH_UNIT_KEYS if content.get(key)), None)
    if key is None:
        return None
    unit_m = number_of(content, key, FILE)
    if not unit_m > 0:
        raise InvalidScanError(f"{FILE}: {key} must be above 0, the metres of one unit of depth.")
    return 1.0 / unit_m


def _file(folder: ScanFolder, name: str, where: str) -> Path | None:
    """Return the file of a path that may be without its suffix, or one of the computer that the scan was made on."""
    tails = _tails(name)
    for tail in tails:
        for candidate in (tail, *(f"{tail}{suffix}" for suffix in _SUFFIXES)):
            path = folder.find(candidate, where)
            if path is not None:
                return path
    # A path that leaves the folder, and ends with nothing that is in it.
    return folder.find(name, where) if name and name not in tails else None


def _tails(name: str) -> list[str]:
    """Return a path, or the ends of one that is absolute or leaves the folder, the longest first."""
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    is_absolute = name.startswith(("/", "\\")) or ":" in parts[0] if parts else False
    if not is_absolute and ".." not in parts:
        return ["/".join(parts)] if parts else []
    inner = [part for part in parts if part != ".." and ":" not in part]
    return ["/".join(inner[i:]) for i in range(len(inner))]


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in _NUMBERS.split(name)]


def _camera(values: Mapping[str, Any], frame: Frame) -> Camera | None:
    """Return the camera of a frame; the size of its picture stands in where the file states none. None for a picture
    that can't be read."""
    size, where = color_size(frame.color), f"{FILE}: {values.get('file_path')}"
    if size is None:
        return None
    # Some tools write the names in small letters, or null for what they don't know.
    stated = str(values.get("camera_model") or PERSPECTIVE[0])
    model = stated.upper()
    if model not in (*PERSPECTIVE, FISHEYE):
        raise InvalidScanError(
            f"{where}: camera_model {stated!r} is not known; use one of {', '.join((*PERSPECTIVE, FISHEYE))}."
        )
    is_fisheye = model == FISHEYE or values.get("is_fisheye") is True
    sized = {"w": size[0], "h": size[1], **values}
    intrinsics = _intrinsics(sized, _FISHEYE_LENS if is_fisheye else _LENS, where)
    width, height = (int(number_of(sized, key, where)) for key in ("w", "h"))
    with camera_stated_in(where):
        return Camera(*_model_of(intrinsics, is_fisheye, width, height))


def _model_of(
    values: tuple[float, ...], is_fisheye: bool, width: int, height: int
) -> tuple[str, int, int, tuple[float, ...]]:
    if is_fisheye:
        return FISHEYE, width, height, values
    # Zeros are no lens that was measured.
    if not any(values[4:]):
        return "PINHOLE", width, height, values[:4]
    return (
        ("FULL_OPENCV", width, height, values) if any(values[8:]) else ("OPENCV", width, height, values[:8])
    )


def _intrinsics(values: Mapping[str, Any], lens: tuple[str, ...], where: str) -> tuple[float, ...]:
    """Return `fx fy cx cy` and the lens; angles of view stand in for focal lengths, the middle for the principal
    point."""
    width, height = (number_of(values, key, where) for key in ("w", "h"))
    fx = _focal_px(values, "fl_x", "camera_angle_x", width, where)
    has_y = "fl_y" in values or ("camera_angle_y" in values and "fl_x" not in values)
    fy = _focal_px(values, "fl_y", "camera_angle_y", height, where) if has_y else fx
    middle = {"cx": width / 2, "cy": height / 2}
    cx, cy = (number_of({**middle, **values}, key, where) - CORNER_TO_CENTRE_PX for key in middle)
    return fx, fy, cx, cy, *(number_of(values, key, where) if key in values else 0.0 for key in lens)


def _focal_px(values: Mapping[str, Any], key: str, angle_key: str, size: float, where: str) -> float:
    if key in values or angle_key not in values:
        return number_of(values, key, where)
    angle_rad = number_of(values, angle_key, where)
    if not 0 < angle_rad < np.pi:
        raise InvalidScanError(f"{where}: {angle_key} must be an angle of view in radians.")
    return float(size / (2 * np.tan(angle_rad / 2)))


def _frames(
    folder: ScanFolder,
    entries: list[dict[str, Any]],
    scale: float,
    has_depth: bool,
    discarded: Discarded,
) -> tuple[list[Frame], list[dict[str, Any]]]:
    """Return the frames that have all of their files, and what the list says of each; without depth a frame's picture
    stands for it."""
    frames, of_frames, invalid = [], [], []
    for number, entry in enumerate(entries):
        where = f"{FILE}: frame {entry.get('file_path')}"
        name, depth_name = str(entry.get("file_path", "")), _depth_name(entry)
        color = _file(folder, name, where)
        depth = _file(folder, depth_name, where) if depth_name else None
        pose = _pose(entry, scale, where)
        if color is None:
            discarded.add("missing_file", name, f"{name} of {FILE}; {folder.instead(name or '?')}")
        elif has_depth and not depth_name:
            discarded.add("no_depth", name)
        elif has_depth and depth is None:
            detail = f"{depth_name} of {FILE}; {folder.instead(depth_name)}"
            discarded.add("missing_file", name, detail)
        elif pose is None:
            discarded.add("invalid_pose", name)
            invalid.append(name)
        else:
            time_s = number / FRAME_RATE_HZ
            frames.append(Frame(folder.name_of(color), time_s, color, depth or color, pose))
            of_frames.append(entry)
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames, of_frames


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
