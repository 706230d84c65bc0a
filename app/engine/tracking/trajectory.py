"""The past of a tracked camera, corrected when a fix says where it has come to: a pose graph between two fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from app.engine.query.placed import Accuracy
from app.engine.tracking.drift import MOTION
from app.geometry.graphs.pose_graph import Known, Motion, gauss_newton_step, isotropic_weights, moved
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
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
    motions = [_motion(row, a.inverse() @ b) for row, (a, b) in enumerate(pairwise(path))]
    known = [_known(0, first), _known(len(path) - 1, last)]
    for _ in range(OPTIONS.steps):
        step = gauss_newton_step(poses, motions, known)
        poses = moved(poses, step)
        if float(np.abs(step).max()) < OPTIONS.min_step:
            break
    return poses


def _weights(position_m: float, rotation_rad: float) -> Array:
    return isotropic_weights(max(position_m, OPTIONS.still_m), max(rotation_rad, OPTIONS.still_rad))


def _motion(row: int, motion: Pose) -> Motion:
    """Return a step of odometry from a row to the next."""
    weights = _weights(
        OPTIONS.still_m + MOTION.drift_ratio * float(np.linalg.norm(motion.translation)),
        OPTIONS.still_rad + MOTION.turn_drift_ratio * attitude_difference_rad(Pose.identity(), motion),
    )
    return Motion(row, row + 1, motion, weights)


def _known(row: int, fix: Anchored) -> Known:
    weights = _weights(fix.accuracy.position_m, float(np.radians(fix.accuracy.orientation_deg)))
    return Known(row, fix.pose, weights)


def largest_change_m(path: Sequence[Pose], corrected: Sequence[Pose]) -> float:
    """Return how far a correction moves a pose at most."""
    return max((position_difference_m(a, b) for a, b in zip(path, corrected, strict=True)), default=0.0)
