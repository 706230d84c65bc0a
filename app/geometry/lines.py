"""Lines on the plan, and the point nearest to several of them: the user's position (B eq. 14-16)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError
from app.geometry.validation import finite_points, finite_vector
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class LineOptions:
    """When two lines are parallel."""

    min_crossing_sine: float = limit(
        1e-3,
        "Two lines whose angle has a smaller sine than this are parallel.",
        chosen="By hand: 0.06 degrees, at which the position of the crossing is meaningless.",
    )


OPTIONS = LineOptions()


def line_through(first: ArrayLike, second: ArrayLike) -> Array:
    """Return `a b c` (3,) of the line a x + b y + c = 0, a^2 + b^2 = 1, through two points (B eq. 14).

    Raises `DegenerateGeometryError` for points that coincide.
    """
    p, q = finite_vector(first, 2, "point"), finite_vector(second, 2, "point")
    length = float(np.linalg.norm(q - p))
    if length < 1e-9:
        raise DegenerateGeometryError("Two points in one spot give no line.")
    a, b = (p[1] - q[1]) / length, (q[0] - p[0]) / length
    return np.array([a, b, -(a * p[0] + b * p[1])])


def distances_to_lines(point: ArrayLike, lines: ArrayLike) -> Array:
    """Return the distances (n,) of a point (2,), or (m, n) of points (m, 2), from lines (n, 3), a b c of any length
    (B eq. 16)."""
    unit = _unit_lines(lines)
    points = finite_points(np.atleast_2d(np.asarray(point, dtype=np.float64)), 2, "points")
    distances = np.abs(points @ unit[:, :2].T + unit[:, 2])
    return np.asarray(distances[0] if np.ndim(point) == 1 else distances)


def point_nearest_to_lines(lines: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the point (2,) with the least sum of distances to lines (n, 3), times weights (n,).

    The sum is convex and linear between the lines, so it has a minimum where two lines cross: the result is the best
    crossing, or the mean of those that are equally good. Raises `DegenerateGeometryError` when no two
    lines cross. Source: B eq. 15.
    """
    unit = _unit_lines(lines)
    factors = np.ones(len(unit)) if weights is None else finite_vector(weights, len(unit), "weights")
    crossings = _crossings(unit)
    sums = distances_to_lines(crossings, unit) @ factors
    best = float(sums.min())
    return np.asarray(crossings[sums <= best + 1e-9 * (1.0 + best)].mean(axis=0))


def point_least_squares_to_lines(lines: ArrayLike) -> Array:
    """Return the point (2,) with the least sum of squared distances to lines (n, 3).

    Unlike `point_nearest_to_lines` it is not robust: one wrong line moves it. Raises `DegenerateGeometryError` when
    no two lines cross.
    """
    unit = _unit_lines(lines)
    if len(unit) < 2 or np.linalg.svd(unit[:, :2], compute_uv=False)[1] < OPTIONS.min_crossing_sine:
        raise DegenerateGeometryError("The lines are parallel: no point is nearest.")
    return np.asarray(np.linalg.lstsq(unit[:, :2], -unit[:, 2], rcond=None)[0])


def _unit_lines(lines: ArrayLike) -> Array:
    values = finite_points(lines, 3, "lines")
    lengths = np.hypot(values[:, 0], values[:, 1])
    if (lengths < 1e-12).any():
        raise DegenerateGeometryError("A line whose a and b are both zero has no direction.")
    return np.asarray(values / lengths[:, None])


def _crossings(unit: Array) -> Array:
    pairs = np.array(list(combinations(range(len(unit)), 2)), dtype=int).reshape(-1, 2)
    first, second = unit[pairs[:, 0]], unit[pairs[:, 1]]
    # In homogeneous coordinates the crossing is the cross product; its last coordinate is the sine of the angle.
    meet = np.cross(first, second)
    meet = meet[np.abs(meet[:, 2]) > OPTIONS.min_crossing_sine]
    if len(meet) == 0:
        raise DegenerateGeometryError("The lines are parallel: no point is nearest.")
    return np.asarray(meet[:, :2] / meet[:, 2:])
