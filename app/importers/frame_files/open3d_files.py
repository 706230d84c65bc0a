"""Open3D's JSON files: a camera, whose matrix stands by columns, and a trajectory of cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import check_pose_ratio
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.scan_camera import camera_stated_in

_HEAD_BYTES = 4096
_TRAJECTORY = b"PinholeCameraTrajectory"
_MATRIX = b"intrinsic_matrix"


def is_open3d_trajectory(path: Path) -> bool:
    """Whether a JSON file is a trajectory of Open3D, by its beginning or, as keys are in any order, its end."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        file.seek(-min(_HEAD_BYTES, path.stat().st_size), 2)
        return _TRAJECTORY in head or _TRAJECTORY in file.read()


def holds_open3d_camera(path: Path) -> bool:
    """Whether a JSON file is a camera of Open3D, by its beginning."""
    with path.open("rb") as file:
        return _MATRIX in file.read(_HEAD_BYTES)


def open3d_trajectory(path: Path) -> tuple[list[Pose | None], Camera]:
    """Return `scan_from_camera` of each camera, None for numbers that are no pose, and the first one's intrinsics.

    The file has `camera_from_scan` by columns. Raises `InvalidScanError` that names the place of what is not this.
    """
    listed = read_json_object(path).get("parameters")
    if not isinstance(listed, list) or not listed or not all(isinstance(item, dict) for item in listed):
        raise InvalidScanError(f"{path.name} lists no cameras in its `parameters`.")
    poses = [_pose(item, f"{path.name}: camera {number}") for number, item in enumerate(listed)]
    invalid = [number for number, pose in enumerate(poses) if pose is None]
    check_pose_ratio(len(invalid), len(poses), f"that of camera {invalid[0]}" if invalid else "")
    intrinsic = listed[0].get("intrinsic")
    return poses, open3d_camera(intrinsic if isinstance(intrinsic, dict) else {}, path.name)


def _pose(item: dict[str, Any], where: str) -> Pose | None:
    values = item.get("extrinsic")
    if not isinstance(values, list) or len(values) != 16:
        raise InvalidScanError(f"{where}: extrinsic must be sixteen numbers, by columns.")
    try:
        matrix = np.array(values, dtype=np.float64).reshape(4, 4).T
        return Pose.from_matrix(matrix).inverse()
    except (TypeError, ValueError, InvalidPoseError):
        return None


def open3d_camera(content: dict[str, Any], name: str) -> Camera:
    """Return the camera of Open3D's JSON; raises `InvalidScanError` that names the file."""
    values = content.get("intrinsic_matrix")
    if not isinstance(values, list) or len(values) != 9:
        raise InvalidScanError(f"{name}: intrinsic_matrix must be nine numbers, by columns.")
    K = {str(i): value for i, value in enumerate(values)}
    fx, fy, cx, cy = (number_of(K, key, f"{name}: intrinsic_matrix") for key in ("0", "4", "6", "7"))
    width, height = (int(number_of(content, key, name)) for key in ("width", "height"))
    with camera_stated_in(name):
        return Camera("PINHOLE", width, height, (fx, fy, cx, cy))
