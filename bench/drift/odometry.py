"""Poses of a scan as odometry with drift would have them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from app.geometry.se3 import Pose, position_difference_m, rotation_from_vector
from bench.render.noise import seeded

Array = NDArray[np.float64]
# Drift is measured as for odometry on roads: the mean error at the end of all stretches of a length, over the length.
STRETCH_M = 10.0
# Half of the drift is of the length of steps, half of the direction; both change slowly along the way.
CHANGES_EVERY_M = 5.0
# Rotation errors (rad) per metre beside each unit of the relative errors of length.
RAD_PER_M = 0.2
SEARCH_STEPS = 5


def with_drift(poses: Sequence[Pose], drift_ratio: float, seed: int = 0) -> list[Pose]:
    """Return the path with drift of a ratio (0.01 is one percent) of the way; the first pose stays."""
    steps = [a.inverse() @ b for a, b in pairwise(poses)]
    lengths = np.array([np.linalg.norm(step.translation) for step in steps])
    noise = _noise(lengths, seed)
    amount = drift_ratio
    for _ in range(SEARCH_STEPS):
        found = measured_drift(poses, _drifted(poses[0], steps, lengths, amount * noise))
        amount *= drift_ratio / found
    return _drifted(poses[0], steps, lengths, amount * noise)


def measured_drift(true: Sequence[Pose], path: Sequence[Pose]) -> float:
    """Return the mean error at the ends of stretches of 10 m, or of half of a shorter path, over their length."""
    along = np.concatenate([[0.0], np.cumsum([position_difference_m(a, b) for a, b in pairwise(true)])])
    stretch = min(STRETCH_M, along[-1] / 2)
    errors = []
    for start in range(len(true)):
        end = int(np.searchsorted(along, along[start] + stretch))
        if end < len(true):
            a = true[start].inverse() @ true[end]
            b = path[start].inverse() @ path[end]
            errors.append(position_difference_m(a, b) / stretch)
    return float(np.mean(errors))


def _noise(lengths: Array, seed: int) -> Array:
    """Return relative errors of length and of three rotations (n, 4), of unit variance along the way."""
    rng = seeded("odometry", seed, len(lengths))
    every_m = 0.1
    count = int(lengths.sum() / every_m) + 2
    smooth = gaussian_filter1d(
        rng.standard_normal((count, 4)), CHANGES_EVERY_M / every_m, axis=0, mode="wrap"
    )
    smooth /= smooth.std(axis=0)
    # A bias too, as of a wrong scale.
    smooth[:, 0] = 0.7 * smooth[:, 0] + 0.7
    at = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) / every_m
    return np.column_stack([np.interp(at, np.arange(count), smooth[:, k]) for k in range(4)])


def _drifted(first: Pose, steps: Sequence[Pose], lengths: Array, errors: Array) -> list[Pose]:
    path = [first]
    for step, length, (stretched, *turns) in zip(steps, lengths, errors, strict=True):
        turn = rotation_from_vector(RAD_PER_M * length * np.array(turns))
        path.append(path[-1] @ Pose(turn @ step.rotation, (1 + stretched) * step.translation))
    return path
