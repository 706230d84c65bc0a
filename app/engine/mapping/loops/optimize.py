"""A path whose drift is corrected by the loops that it closes: a pose graph with a robust loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from app.geometry.graphs.pose_graph import (
    Known,
    Motion,
    gauss_newton_step,
    isotropic_weights,
    moved,
    relative_error,
)
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphOptions:
    """How sure odometry and loops are, and how the graph is solved."""

    odometry_m: float = limit(
        0.02,
        "Standard deviation of odometry's position after one metre of way; it grows with the root of the way.",
        chosen="By hand: one to two percent of ten metres.",
    )
    odometry_rad: float = limit(
        0.005, "The same of the attitude.", chosen="By hand: one degree after ten metres."
    )
    odometry_rad_per_rad: float = limit(
        0.005, "Standard deviation of the attitude per radian turned.", chosen="By hand: half a percent."
    )
    least_m: float = limit(
        0.0005, "Standard deviation of a step however short it is.", chosen="By hand: its noise."
    )
    least_rad: float = limit(
        0.0002, "Standard deviation of a turn however small it is.", chosen="By hand: its noise."
    )
    loop_m: float = limit(
        0.015, "Standard deviation of a loop's position.", chosen="By hand: what depth is off by."
    )
    loop_rad: float = limit(
        0.006, "Standard deviation of a loop's attitude.", chosen="By hand: a third of a degree."
    )
    loss_scale: float = limit(
        2.0,
        "Error of a loop in standard deviations at which its weight falls to half (Cauchy loss).",
        chosen="By hand: beyond the usual error.",
    )
    scale_step: float = limit(
        0.6,
        "The loss begins as wide as the loops' largest usual error and narrows by this ratio a step.",
        chosen="By hand: graduated non-convexity; a wide loss has one minimum.",
    )
    steps: int = limit(
        40, "Largest number of Gauss-Newton steps.", chosen="By hand: enough to narrow the loss."
    )
    min_step: float = limit(
        1e-4, "The steps end when no pose changes by more, metres and radians.", chosen="By hand: 0.1 mm."
    )


OPTIONS = GraphOptions()


@dataclass(frozen=True, slots=True)
class Loop:
    """A measured `a_from_b` of two rows of the path (a < b)."""

    a: int
    b: int
    a_from_b: Pose


def optimized(path: Sequence[Pose], loops: Sequence[Loop]) -> list[Pose]:
    """Return the path (its first pose stays) that fits its own steps and the loops best.

    The weights of the loops are those of Cauchy's loss, by iterated reweighting, whose scale narrows from step to step.
    Source: Yang et al., "Graduated Non-Convexity for Robust Spatial Perception", 2020.
    """
    if not loops:
        return list(path)
    steps = [_step(row, a.inverse() @ b) for row, (a, b) in enumerate(pairwise(path))]
    known = [Known(0, path[0], np.full(6, 1e6))]
    whole = isotropic_weights(OPTIONS.loop_m, OPTIONS.loop_rad)
    poses = list(path)
    scale = max(OPTIONS.loss_scale, float(np.quantile(_errors(poses, loops, whole), 0.9)))
    for _ in range(OPTIONS.steps):
        weights = 1.0 / np.sqrt(1.0 + (_errors(poses, loops, whole) / scale) ** 2)
        closed = [
            Motion(loop.a, loop.b, loop.a_from_b, weight * whole)
            for loop, weight in zip(loops, weights, strict=True)
        ]
        step = gauss_newton_step(poses, [*steps, *closed], known)
        poses = moved(poses, step)
        if scale == OPTIONS.loss_scale and float(np.abs(step).max()) < OPTIONS.min_step:
            break
        scale = max(OPTIONS.loss_scale, OPTIONS.scale_step * scale)
    return poses


def loop_errors_m(path: Sequence[Pose], loops: Sequence[Loop]) -> Array:
    """Return by how many metres (n,) the path contradicts each loop."""
    return np.array(
        [position_difference_m(path[loop.a].inverse() @ path[loop.b], loop.a_from_b) for loop in loops]
    )


def _errors(path: Sequence[Pose], loops: Sequence[Loop], weights: Array) -> Array:
    """Return the errors (n,) of the loops in standard deviations, root mean square of their six numbers."""
    found = [relative_error(path[loop.a], path[loop.b], loop.a_from_b)[0] for loop in loops]
    return np.asarray(np.sqrt(((weights * np.array(found)) ** 2).mean(axis=1)))


def _step(row: int, motion: Pose) -> Motion:
    length = float(np.linalg.norm(motion.translation))
    turn = attitude_difference_rad(Pose.identity(), motion)
    weights = isotropic_weights(
        max(OPTIONS.least_m, OPTIONS.odometry_m * float(np.sqrt(length))),
        max(
            OPTIONS.least_rad,
            float(np.hypot(OPTIONS.odometry_rad * np.sqrt(length), OPTIONS.odometry_rad_per_rad * turn)),
        ),
    )
    return Motion(row, row + 1, motion, weights)
