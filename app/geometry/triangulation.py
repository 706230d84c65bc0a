"""Points from two views whose relative pose is known, and the metric scale a known distance gives."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs, finite_vector

Array = NDArray[np.float64]

# Rays nearer to parallel than this meet anywhere: at one pixel of noise the depth is off by half.
MIN_PARALLAX_DEG = 0.2


def homogeneous(normalized: ArrayLike) -> Array:
    """Return the rays (n, 3), z = 1, of undistorted image-plane coordinates (n, 2)."""
    points = np.asarray(normalized, dtype=np.float64).reshape(-1, 2)
    return np.hstack([points, np.ones((len(points), 1))])


def unit_rays(rays: Array) -> Array:
    """Return rays (n, 3) with length 1."""
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def parallax_deg(normalized_a: ArrayLike, normalized_b: ArrayLike, b_from_a: Pose) -> Array:
    """Return the angles (n,) between rays that meet, of image-plane coordinates (n, 2), (n, 2).

    What the rotation between the cameras does to the directions is taken out.
    """
    a, b = homogeneous(normalized_a) @ b_from_a.rotation.T, homogeneous(normalized_b)
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))))


def pixel_depths(normalized_a: ArrayLike, normalized_b: ArrayLike, b_from_a: Pose) -> tuple[Array, Array]:
    """Return s1 and s2, the z-depths (n,), (n,) in both cameras, in the unit of `b_from_a`.

    Takes undistorted image-plane coordinates (n, 2), (n, 2), K^-1 x. Each depth solves its linear equation by
    least squares. NaN where the rays are parallel; below zero where they meet behind a camera. Source: C eq.
    4.2.3 and 4.2.5-4.2.6, with the ray of a turned by R in 4.2.6: without it the term in s1 stays unless R is
    the identity.
    """
    a, b = finite_pairs(normalized_a, 2, "image-plane points", normalized_b, 2, "image-plane points")
    turned, seen = homogeneous(a) @ b_from_a.rotation.T, homogeneous(b)
    by_s1, by_s2 = np.cross(seen, turned), np.cross(turned, seen)
    s1 = _solve_rowwise(by_s1, -np.cross(seen, b_from_a.translation))
    s2 = _solve_rowwise(by_s2, np.cross(turned, b_from_a.translation))
    return s1, s2


def triangulate(
    points_a_px: ArrayLike,
    points_b_px: ArrayLike,
    camera_a: Camera,
    camera_b: Camera,
    b_from_a: Pose,
    *,
    min_parallax_deg: float = MIN_PARALLAX_DEG,
) -> Array:
    """Return the points (n, 3) of matched pixels, in the frame of camera a and unit of `b_from_a`.

    Linear (DLT) on undistorted rays of pixels (n, 2), (n, 2). NaN for a point whose rays are too near to
    parallel or that would lie behind a camera. Raises `DegenerateGeometryError` when the cameras share one
    centre, `InvalidInputError` for numbers that are not finite. Source: Hartley and Zisserman, section 12.2.
    """
    a_px, b_px = finite_pairs(points_a_px, 2, "pixels", points_b_px, 2, "pixels")
    if np.linalg.norm(b_from_a.translation) < 1e-9:
        raise DegenerateGeometryError("Two views from one place don't fix any depth.")
    if len(a_px) == 0:
        return np.empty((0, 3))
    a, b = camera_a.normalize(a_px), camera_b.normalize(b_px)
    solution = cv2.triangulatePoints(np.eye(3, 4), b_from_a.matrix[:3], a.T, b.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = np.asarray((solution[:3] / solution[3]).T, dtype=np.float64)
    in_front = (points[:, 2] > 0) & (b_from_a.apply(points)[:, 2] > 0)
    points[~in_front | (parallax_deg(a, b, b_from_a) < min_parallax_deg)] = np.nan
    return points


def metric_scale(distance_m: float, depth: float, normalized: ArrayLike) -> float:
    """Return r, the metres per unit of a relative pose, from a known distance of monitoring camera and POI.

    `depth` is the POI's depth s2 along z in the monitoring camera and `normalized` (2,) its image-plane
    coordinates there. Raises `DegenerateGeometryError` unless both lengths are positive. Source: C eq. 4.2.7;
    the source divides by s2 itself, but l runs along the ray, which off the optical axis is longer than the
    depth.
    """
    x, y = finite_vector(normalized, 2, "image-plane point")
    length = depth * float(np.sqrt(x * x + y * y + 1.0))
    if not (np.isfinite(length) and length > 0 and np.isfinite(distance_m) and distance_m > 0):
        raise DegenerateGeometryError("A scale needs a POI in front of the camera and a distance above zero.")
    return distance_m / length


def _solve_rowwise(factors: Array, values: Array) -> Array:
    """Return s (n,) with s * factors (n, 3) nearest to values (n, 3); NaN where the factors vanish."""
    squared = np.sum(factors**2, axis=1)
    solvable = squared > 1e-20
    s = np.full(len(factors), np.nan)
    s[solvable] = np.sum(factors * values, axis=1)[solvable] / squared[solvable]
    return s
