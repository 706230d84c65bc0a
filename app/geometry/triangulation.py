"""Points from two views whose relative pose is known, the metric scale by a known distance, and pieces of rays."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs, finite_vector
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangulationOptions:
    """When two rays determine a point."""

    min_parallax_deg: float = limit(
        0.2,
        "Least angle between two rays that determine a point.",
        chosen="By hand: at this angle an error of one pixel changes the depth by about half.",
    )


OPTIONS = TriangulationOptions()


def homogeneous(normalized: ArrayLike) -> Array:
    """Return the rays (n, 3), with z = 1, of undistorted image-plane coordinates (n, 2)."""
    points = np.asarray(normalized, dtype=np.float64).reshape(-1, 2)
    return np.hstack([points, np.ones((len(points), 1))])


def unit_rays(rays: Array) -> Array:
    """Return rays (n, 3) with length 1."""
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def parallax_deg(normalized_a: ArrayLike, normalized_b: ArrayLike, b_from_a: Pose) -> Array:
    """Return the angles (n,) in degrees between the rays of matches, image-plane coordinates (n, 2), (n, 2).

    The angles are those at the points: the rotation between the cameras is removed.
    """
    a, b = homogeneous(normalized_a) @ b_from_a.rotation.T, homogeneous(normalized_b)
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))))


def pixel_depths(normalized_a: ArrayLike, normalized_b: ArrayLike, b_from_a: Pose) -> tuple[Array, Array]:
    """Return s1 and s2, the z-depths (n,), (n,) in both cameras, in the unit of `b_from_a`.

    Takes undistorted image-plane coordinates (n, 2), (n, 2), K^-1 x. Each depth is the least-squares solution of its
    linear equation. NaN for parallel rays; negative for a point behind a camera. Source: C eq. 4.2.3 and 4.2.5-4.2.6,
    but in 4.2.6 the ray of a is rotated by R; without that the term with s1 vanishes only if R is the identity.
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
    min_parallax_deg: float = OPTIONS.min_parallax_deg,
) -> Array:
    """Return the points (n, 3) of matched pixels, in the frame of camera a and unit of `b_from_a`.

    Linear (DLT) on the undistorted rays of pixels (n, 2), (n, 2). NaN for a point whose rays are nearly parallel, or
    that would be behind a camera. Raises `DegenerateGeometryError` when both cameras have the same centre,
    `InvalidInputError` for numbers that are not finite. Source: Hartley and Zisserman, section 12.2.
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
    """Return r, the metres per unit of a relative pose, by the known distance of monitoring camera and POI.

    `depth` is the POI's depth s2 along z in the monitoring camera and `normalized` (2,) its image-plane
    coordinates there. Raises `DegenerateGeometryError` unless both lengths are positive. Source: C eq. 4.2.7. The
    source divides by s2 itself, but l is measured along the ray, which is longer than the depth except on the
    optical axis.
    """
    x, y = finite_vector(normalized, 2, "image-plane point")
    length = depth * float(np.sqrt(x * x + y * y + 1.0))
    if not (np.isfinite(length) and length > 0 and np.isfinite(distance_m) and distance_m > 0):
        raise DegenerateGeometryError("A scale needs a POI in front of the camera and a distance above zero.")
    return distance_m / length


def _solve_rowwise(factors: Array, values: Array) -> Array:
    """Return s (n,) for which s * factors (n, 3) is nearest to values (n, 3); NaN where the factors are zero."""
    squared = np.sum(factors**2, axis=1)
    solvable = squared > 1e-20
    s = np.full(len(factors), np.nan)
    s[solvable] = np.sum(factors * values, axis=1)[solvable] / squared[solvable]
    return s


def distances_to_segments(
    points: NDArray[np.float32], first: NDArray[np.float32], last: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the distances (...) of points (..., 3) from the segments between the ends `first` and `last` (..., 3),
    whose shapes broadcast, in the points' unit."""
    along = last - first
    squared = np.einsum("...i,...i->...", along, along)
    share = np.einsum("...i,...i->...", points - first, along) / np.maximum(
        squared, np.finfo(np.float32).tiny
    )
    nearest = first + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points - nearest, axis=-1), np.float32)
