"""Rotations and translations that align one set of points, or one frame, with another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.se3 import (
    Pose,
    project_to_so3,
    rotation_between,
    rotation_from_vector,
    vector_from_rotation,
)
from app.geometry.validation import finite_pairs, unit_vector
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentOptions:
    """When points are too close together to align, and how long a median is iterated."""

    min_spread_m: float = limit(
        1e-6,
        "Points that are spread over less than this count as one point.",
        chosen="By hand: far below any measured distance, far above the rounding error.",
    )
    median_steps: int = limit(
        50,
        "Iterations of Weiszfeld's algorithm for a geometric median.",
        chosen="By hand: meant to be enough to converge.",
    )


OPTIONS = AlignmentOptions()


class Alignment(NamedTuple):
    """A fitted `target_from_source`: x_target = scale * rotation @ x_source + translation."""

    target_from_source: Pose
    scale: float
    residual_rms_m: float


def align_points(
    points_in_source: ArrayLike, points_in_target: ArrayLike, *, with_scale: bool = False
) -> Alignment:
    """Return the rotation, translation and, if `with_scale`, scale that best align points (n, 3) with (n, 3).

    Least squares, never a mirror image. Raises `DegenerateGeometryError` for fewer than three points or
    points on one line, `InvalidInputError` for numbers that are not finite. Source: Kabsch, Umeyama; with the
    camera-frame points of EPnP it is the last step of B section 2.3.
    """
    source, target = finite_pairs(points_in_source, 3, "source points", points_in_target, 3, "target points")
    if (
        len(source) < 3
        or _extent(source, 1) < OPTIONS.min_spread_m
        or _extent(target, 1) < OPTIONS.min_spread_m
    ):
        raise DegenerateGeometryError("An alignment in space needs three points that are not on one line.")
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    rotation = project_to_so3(b.T @ a)
    scale = float(np.sum((a @ rotation.T) * b) / np.sum(a**2)) if with_scale else 1.0
    if scale <= 0:
        raise DegenerateGeometryError("The two sets of points are no copies of each other, at any scale.")
    translation = target_mean - scale * rotation @ source_mean
    residuals = scale * source @ rotation.T + translation - target
    return Alignment(
        Pose(rotation, translation), scale, float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))
    )


def align_2d(source: ArrayLike, target: ArrayLike, *, with_scale: bool = True) -> tuple[Array, Array]:
    """Return the rotation times scale (2, 2), and the translation (2,), that best align points (n, 2) with (n, 2).

    Least squares, never a mirror image; the scale is 1 without `with_scale`. Raises `DegenerateGeometryError`
    for fewer than two different points, `InvalidInputError` for numbers that are not finite. Source: Umeyama.
    """
    a, b = finite_pairs(source, 2, "source points", target, 2, "target points")
    if len(a) < 2 or _extent(a, 0) < OPTIONS.min_spread_m or _extent(b, 0) < OPTIONS.min_spread_m:
        raise DegenerateGeometryError("An alignment on the plane needs two points that differ.")
    a_mean, b_mean = a.mean(axis=0), b.mean(axis=0)
    p, q = a - a_mean, b - b_mean
    # In complex numbers, rotation and scale are one factor; its least-squares estimate is a quotient.
    cos, sin = float(np.sum(p * q)), float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
    length = np.hypot(cos, sin)
    if length < OPTIONS.min_spread_m**2:
        raise DegenerateGeometryError("The two sets of points are no copies of each other, at any scale.")
    scale = length / float(np.sum(p**2)) if with_scale else 1.0
    linear = scale * rotation_2d(float(np.arctan2(sin, cos)))
    return linear, b_mean - linear @ a_mean


def fit_affine_2d(source: ArrayLike, target: ArrayLike) -> tuple[Array, Array]:
    """Return the affine map, a matrix (2, 2) and a translation (2,), that best maps points (n, 2) to (n, 2).

    Least squares. Raises `DegenerateGeometryError` for fewer than three points or points on one line.
    """
    a, b = finite_pairs(source, 2, "source points", target, 2, "target points")
    if len(a) < 3 or _extent(a, 1) < OPTIONS.min_spread_m:
        raise DegenerateGeometryError("An affine map needs three points that are not on one line.")
    mean = a.mean(axis=0)
    solution = np.linalg.lstsq(np.column_stack([a - mean, np.ones(len(a))]), b, rcond=None)[0]
    linear = solution[:2].T
    return linear, solution[2] - linear @ mean


def rotation_2d(angle_rad: float) -> Array:
    """Return the matrix (2, 2) that rotates the plane counter-clockwise (C eq. 4.3.6)."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def average_poses(
    world_from_camera: Sequence[Pose], weights: ArrayLike | None = None, *, robust: bool = True
) -> Pose:
    """Return the average of several estimates of one pose.

    With `robust` it is the geometric median of the positions and of the rotations, which a minority of wrong
    estimates changes little; otherwise the weighted mean (chordal for rotations). `weights` (n,) are relative.
    Raises `DegenerateGeometryError` for no estimate, `InvalidInputError` for weights that are negative or all
    zero. Source: Weiszfeld's algorithm; on rotations, Hartley et al., "L1 rotation averaging", 2011.
    """
    if len(world_from_camera) == 0:
        raise DegenerateGeometryError("No pose to average.")
    normalized = _normalized_weights(weights, len(world_from_camera))
    positions = np.stack([pose.translation for pose in world_from_camera])
    rotations = np.stack([pose.rotation for pose in world_from_camera])
    position = normalized @ positions
    rotation = project_to_so3(np.tensordot(normalized, rotations, axes=1))
    if robust:
        position = _median_position(positions, normalized, position)
        rotation = _median_rotation(rotations, normalized, rotation)
    return Pose(rotation, position)


def _normalized_weights(weights: ArrayLike | None, count: int) -> Array:
    values = np.ones(count) if weights is None else np.asarray(weights, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all() or (values < 0).any() or values.sum() <= 0:
        raise InvalidInputError(f"Weights must be {count} finite numbers, not negative and not all zero.")
    return np.asarray(values / values.sum())


def _median_position(positions: Array, weights: Array, start: Array) -> Array:
    median = start
    for _ in range(OPTIONS.median_steps):
        offsets = positions - median
        median = median + _weiszfeld_step(offsets, weights)
    return median


def _median_rotation(rotations: Array, weights: Array, start: Array) -> Array:
    median = start
    for _ in range(OPTIONS.median_steps):
        offsets = np.stack([vector_from_rotation(rotation @ median.T) for rotation in rotations])
        median = rotation_from_vector(_weiszfeld_step(offsets, weights)) @ median
    return median


def _weiszfeld_step(offsets: Array, weights: Array) -> Array:
    """Return the step (d,) from the present estimate of a geometric median, given the offsets (n, d) of the points."""
    # The lower bound avoids a division by zero where the present estimate is one of the points.
    scaled = weights / np.maximum(np.linalg.norm(offsets, axis=1), 1e-9)
    return np.asarray(scaled @ offsets / scaled.sum())


def world_from_scan_by_gravity(gravity_in_scan: ArrayLike) -> Pose:
    """Return the `world_from_scan` of the smallest rotation that makes z point up.

    `gravity_in_scan` (3,) is the direction of down in the scan's frame, of any length. The origin stays.
    Raises `InvalidInputError` for a vector that has no direction.
    """
    down = unit_vector(gravity_in_scan, 3, "gravity")
    return Pose(rotation_between(down, [0.0, 0.0, -1.0]), np.zeros(3))


def _extent(points: Array, axis: int) -> float:
    """Return the root mean square spread of points (n, d) along a principal axis, 0 the longest."""
    centred = points - points.mean(axis=0) if len(points) else points
    return (
        float(np.linalg.svd(centred, compute_uv=False)[axis] / np.sqrt(len(points)))
        if len(points) > axis
        else 0.0
    )
