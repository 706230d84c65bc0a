"""What apps that record ARKit have in common: axes of the camera, the direction of down, confidence images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidPoseError
from app.geometry.se3 import Pose
from app.importers.folder import ScanFolder

# ARKit's camera looks along -z, its y is up.
ARKIT_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
# ARKit's world has y up, by the phone's accelerometer.
ARKIT_DOWN = (0.0, -1.0, 0.0)


def pose_of_arkit(world_from_arkit_camera: NDArray[np.float64]) -> Pose | None:
    """Return `scan_from_camera` of a matrix (4, 4) with ARKit's camera axes, None for one that is no pose."""
    try:
        return Pose.from_matrix(world_from_arkit_camera @ ARKIT_FROM_CAMERA)
    except InvalidPoseError:
        return None


def confidence_files(folder: ScanFolder, depth: str, confidence: str) -> dict[Path, Path]:
    """Return the confidence image of each depth image, where two folders have files of the same stem."""
    depth_folder, confidence_folder = folder.path / depth, folder.path / confidence
    if not depth_folder.is_dir() or not confidence_folder.is_dir():
        return {}
    by_stem = {path.stem: path for path in folder.files_in(confidence_folder)}
    files = (path for path in folder.files_in(depth_folder) if path.stem in by_stem)
    return {path: by_stem[path.stem] for path in files}
