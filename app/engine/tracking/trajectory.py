"""The past of a tracked camera, corrected when a fix says where it has come to: a pose graph between two fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from app.engine.query.placed import Accuracy
from app.engine.tracking.drift import MOTION
from app.geometry.reprojection import perturbed
from app.geometry.se3 import (
    Pose,
    attitude_difference_rad,
    position_difference_m,
    skew,
    vector_from_rotation,
)
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGraphOptions:
    """How the path between two fixes is corrected."""

    steps: int = limit(
        8,
        "Largest number of Gauss-Newton steps.",
        chosen="By hand: a correction is small, and a few are enough.",
    )
    min_step: float = limit(
        1e-5, "The steps end when no pose changes by more, metres and radians.", chosen="By hand: 0.01 mm."
    )
    still_m: float = limit(
        0.001, "Standard deviation of a step of odometry however short it is.", chosen="By hand: its noise."
    )
    still_rad: float = limit(
        0.0005, "Standard deviation of a turn of odometry however small it is.", chosen="By hand: its noise."
    )


OPTIONS = PoseGraphOptions()


@dataclass(frozen=True, slots=True)
class Anchored:
    """A pose that a fix says, and how accurately."""

    pose: Pose
    accuracy: Accuracy


def corrected_path(path: Sequence[Pose], first: Anchored, last: Anchored) -> list[Pose]:
    """Return a path of odometry, `frame_from_camera` of each frame, corrected by the fixes at both of its ends.

    Minimizes the squared errors of the relative poses of consecutive frames, as odometry measured them, and of the two
    fixes, each over its variance: Gauss-Newton with sparse normal equations over all poses. Odometry's errors grow with
    step and turn (`MotionOptions`).
    """
    poses = [first.pose @ path[0].inverse() @ pose for pose in path]
    measured = [a.inverse() @ b for a, b in pairwise(path)]
    for _ in range(OPTIONS.steps):
        step = _step(poses, measured, first, last)
        poses = [perturbed(pose, change) for pose, change in zip(poses, step, strict=True)]
        if float(np.abs(step).max()) < OPTIONS.min_step:
            break
    return poses


def _step(poses: Sequence[Pose], measured: Sequence[Pose], first: Anchored, last: Anchored) -> Array:
    """Return the Gauss-Newton step (n, 6) of all poses."""
    blocks = _Blocks()
    residuals: list[Array] = []
    for k, motion in enumerate(measured):
        weights = _weights(
            OPTIONS.still_m + MOTION.drift_ratio * float(np.linalg.norm(motion.translation)),
            OPTIONS.still_rad + MOTION.turn_drift_ratio * attitude_difference_rad(Pose.identity(), motion),
        )
        error, by_a, by_b = _relative_error(poses[k], poses[k + 1], motion)
        row = len(residuals)
        blocks.add(row, k, weights[:, None] * by_a)
        blocks.add(row, k + 1, weights[:, None] * by_b)
        residuals.append(weights * error)
    for k, fix in (0, first), (len(poses) - 1, last):
        weights = _weights(fix.accuracy.position_m, float(np.radians(fix.accuracy.orientation_deg)))
        turn = vector_from_rotation(poses[k].rotation @ fix.pose.rotation.T)
        error = np.concatenate([turn, poses[k].translation - fix.pose.translation])
        blocks.add(len(residuals), k, np.diag(weights))
        residuals.append(weights * error)
    jacobian = blocks.matrix(len(residuals), len(poses))
    normal = (jacobian.T @ jacobian).tocsc()
    return np.asarray(-spsolve(normal, jacobian.T @ np.concatenate(residuals))).reshape(-1, 6)


def _weights(position_m: float, rotation_rad: float) -> Array:
    """Return the inverse standard deviations (6,), of rotation and position, whose sigmas are those of lengths."""
    scale = np.sqrt(3.0)
    return np.repeat(
        [
            scale / max(rotation_rad, OPTIONS.still_rad),
            scale / max(position_m, OPTIONS.still_m),
        ],
        3,
    )


def _relative_error(a: Pose, b: Pose, motion: Pose) -> tuple[Array, Array, Array]:
    """Return by how much two poses differ from a motion between them (6,), and the derivatives (6, 6) by each."""
    offset, to_a = b.translation - a.translation, a.rotation.T
    turn = vector_from_rotation(motion.rotation.T @ to_a @ b.rotation)
    error = np.concatenate([turn, to_a @ offset - motion.translation])
    by_a, by_b = np.zeros((6, 6)), np.zeros((6, 6))
    by_b[:3, :3], by_a[:3, :3] = b.rotation.T, -b.rotation.T
    by_b[3:, 3:], by_a[3:, 3:] = to_a, -to_a
    by_a[3:, :3] = to_a @ skew(offset)
    return error, by_a, by_b


class _Blocks:
    """A sparse matrix of blocks (6, 6)."""

    def __init__(self) -> None:
        self._places: list[NDArray[np.intp]] = []
        self._values: list[Array] = []

    def add(self, row: int, column: int, block: Array) -> None:
        """Add a block at a row and column of blocks."""
        i, j = np.mgrid[:6, :6].reshape(2, -1)
        self._places.append(np.stack([6 * row + i, 6 * column + j]))
        self._values.append(block.ravel())

    def matrix(self, rows: int, columns: int) -> csr_matrix:
        """Return the matrix of that number of blocks each way."""
        i, j = np.concatenate(self._places, axis=1)
        return csr_matrix((np.concatenate(self._values), (i, j)), shape=(6 * rows, 6 * columns))


def largest_change_m(path: Sequence[Pose], corrected: Sequence[Pose]) -> float:
    """Return how far a correction moves a pose at most."""
    return max((position_difference_m(a, b) for a, b in zip(path, corrected, strict=True)), default=0.0)
