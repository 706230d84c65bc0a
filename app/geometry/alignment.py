"""Rotations and shifts that bring one set of points, or one frame, onto another."""

from __future__ import annotations

from collections.abc import Sequence
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

Array = NDArray[np.float64]

# Points nearer together than this, in metres, are one point.
MIN_SPREAD = 1e-6
WEISZFELD_STEPS = 50


class Alignment(NamedTuple):
    """A fitted `target_from_source`: x_target = scale * rotation @ x_source + translation."""

    target_from_source: Pose
    scale: float
    residual_rms_m: float


def align_points(
    points_in_source: ArrayLike, points_in_target: ArrayLike, *, with_scale: bool = False
) -> Alignment:
    """Return the rotation, shift and, if `with_scale`, scale that best move points (n, 3) onto (n, 3).

    Least squares, never a mirror image. Raises `DegenerateGeometryError` for fewer than three points or
    points on one line, `InvalidInputError` for numbers that are not finite. Source: Kabsch, Umeyama; with the
    camera-frame points of EPnP it is the last step of B section 2.3.
    """
    source, target = finite_pairs(points_in_source, 3, "source points", points_in_target, 3, "target points")
    if len(source) < 3 or _extent(source, 1) < MIN_SPREAD or _extent(target, 1) < MIN_SPREAD:
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
    """Return the turn and scale (2, 2), and shift (2,), that best move points (n, 2) onto (n, 2).

    Least squares, never a mirror image; the scale is 1 without `with_scale`. Raises `DegenerateGeometryError`
    for fewer than two different points, `InvalidInputError` for numbers that are not finite. Source: Umeyama.
    """
    a, b = finite_pairs(source, 2, "source points", target, 2, "target points")
    if len(a) < 2 or _extent(a, 0) < MIN_SPREAD or _extent(b, 0) < MIN_SPREAD:
        raise DegenerateGeometryError("An alignment on the plane needs two points that differ.")
    a_mean, b_mean = a.mean(axis=0), b.mean(axis=0)
    p, q = a - a_mean, b - b_mean
    # As complex numbers a turn and a scale are one factor, and the least squares for it is a quotient.
    cos, sin = float(np.sum(p * q)), float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
    length = np.hypot(cos, sin)
    if length < MIN_SPREAD**2:
        raise DegenerateGeometryError("The two sets of points are no copies of each other, at any scale.")
    scale = length / float(np.sum(p**2)) if with_scale else 1.0
    linear = scale * rotation_2d(float(np.arctan2(sin, cos)))
    return linear, b_mean - linear @ a_mean


def fit_affine_2d(source: ArrayLike, target: ArrayLike) -> tuple[Array, Array]:
    """Return the affine map, (2, 2) and shift (2,), that best moves points (n, 2) onto (n, 2).

    Least squares. Raises `DegenerateGeometryError` for fewer than three points or points on one line.
    """
    a, b = finite_pairs(source, 2, "source points", target, 2, "target points")
    if len(a) < 3 or _extent(a, 1) < MIN_SPREAD:
        raise DegenerateGeometryError("An affine map needs three points that are not on one line.")
    mean = a.mean(axis=0)
    solution = np.linalg.lstsq(np.column_stack([a - mean, np.ones(len(a))]), b, rcond=None)[0]
    linear = solution[:2].T
    return linear, solution[2] - linear @ mean


def rotation_2d(angle_rad: float) -> Array:
    """Return the matrix (2, 2) that turns the plane counter-clockwise (C eq. 4.3.6)."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def average_poses(
    world_from_camera: Sequence[Pose], weights: ArrayLike | None = None, *, robust: bool = True
) -> Pose:
    """Return the middle of several estimates of one pose.

    With `robust` the geometric median, for positions and for rotations, which a minority of wrong estimates
    can't drag away; else the weighted mean (chordal for rotations). `weights` (n,) count estimates as more
    than one. Raises `DegenerateGeometryError` for no estimate, `InvalidInputError` for weights that are
    negative or all zero. Source: Weiszfeld's algorithm; on rotations, Hartley et al., "L1 rotation
    averaging", 2011.
    """
    if len(world_from_camera) == 0:
        raise DegenerateGeometryError("No pose to average.")
    share = _shares(weights, len(world_from_camera))
    positions = np.stack([pose.translation for pose in world_from_camera])
    rotations = np.stack([pose.rotation for pose in world_from_camera])
    position = share @ positions
    rotation = project_to_so3(np.tensordot(share, rotations, axes=1))
    if robust:
        position = _median_position(positions, share, position)
        rotation = _median_rotation(rotations, share, rotation)
    return Pose(rotation, position)


def _shares(weights: ArrayLike | None, count: int) -> Array:
    values = np.ones(count) if weights is None else np.asarray(weights, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all() or (values < 0).any() or values.sum() <= 0:
        raise InvalidInputError(f"Weights must be {count} finite numbers, not negative and not all zero.")
    return np.asarray(values / values.sum())


def _median_position(positions: Array, share: Array, start: Array) -> Array:
    middle = start
    for _ in range(WEISZFELD_STEPS):
        offsets = positions - middle
        middle = middle + _weiszfeld_step(offsets, share)
    return middle


def _median_rotation(rotations: Array, share: Array, start: Array) -> Array:
    middle = start
    for _ in range(WEISZFELD_STEPS):
        offsets = np.stack([vector_from_rotation(rotation @ middle.T) for rotation in rotations])
        middle = rotation_from_vector(_weiszfeld_step(offsets, share)) @ middle
    return middle


def _weiszfeld_step(offsets: Array, share: Array) -> Array:
    """Return the move (d,) towards the geometric median of what lies at offsets (n, d)."""
    # The floor keeps a guess that has met one of the estimates from dividing by zero.
    pull = share / np.maximum(np.linalg.norm(offsets, axis=1), 1e-9)
    return np.asarray(pull @ offsets / pull.sum())


def world_from_scan_by_gravity(gravity_in_scan: ArrayLike) -> Pose:
    """Return the `world_from_scan` that makes z point up and turns the scan no more than that needs.

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
