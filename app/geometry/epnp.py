"""EPnP as paper B states it: camera-frame points by four control points, then a rigid alignment.

`app.geometry.pnp` uses it after RANSAC.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError
from app.geometry.alignment import align_points
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs
from app.limits import limit

Array = NDArray[np.float64]

# The projection equations determine twelve unknowns only from five points on.
MIN_EPNP_POINTS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class EpnpOptions:
    """When points are flat, and how the factors of the null vectors are refined."""

    planar_ratio: float = limit(
        1e-3,
        "Points whose extent along a principal axis is below this ratio of the largest extent are flat along it.",
        chosen="By hand: flatter points need three control points only, for four are then not determined.",
    )
    gauss_newton_steps: int = limit(
        8,
        "Gauss-Newton steps that refine the factors of the null vectors.",
        chosen="By hand: meant to be enough to converge.",
    )


OPTIONS = EpnpOptions()


def solve_epnp(points_px: ArrayLike, points_in_world: ArrayLike, camera: Camera) -> Pose:
    """Return the `world_from_camera` of pixels (n, 2) and world points (n, 3), all of them inliers.

    Raises `DegenerateGeometryError` for fewer than five points, points on one line, or no pose with all points in
    front of the camera; `InvalidInputError` for numbers that are not finite. Source: B eq. 7-13; Lepetit et al.,
    "EPnP", 2009.
    """
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    if len(pixels) < MIN_EPNP_POINTS:
        raise DegenerateGeometryError("EPnP needs five points.")
    normalized = camera.normalize(pixels)
    candidates = [
        align_points(points, in_camera).target_from_source
        for in_camera in camera_points_candidates(normalized, points)
    ]
    errors = [_image_plane_error(pose.apply(points), normalized) for pose in candidates]
    best = int(np.argmin(errors))
    if not np.isfinite(errors[best]):
        raise DegenerateGeometryError("EPnP found no pose with all points in front of the camera.")
    return candidates[best].inverse()


def camera_points_candidates(normalized: Array, points_in_world: Array) -> list[Array]:
    """Return candidates for the camera-frame points (n, 3) of image-plane points (n, 2) (B eq. 13).

    There is one candidate for each number of null vectors of the projection equations that are combined; the best
    is the one with the least reprojection error.
    """
    control_in_world = control_points(points_in_world)
    weights = barycentric_weights(points_in_world, control_in_world)
    count = len(control_in_world)
    rows = projection_equations(normalized, weights)
    null_vectors = np.linalg.eigh(rows.T @ rows)[1][:, :count].T.reshape(count, count, 3)
    candidates = []
    # Four control points have six distances, which determine the six products of three factors, but no more.
    for used in range(1, count):
        factors = _factors_from_distances(null_vectors, control_in_world, used)
        in_camera = points_from_control(weights, np.tensordot(factors, null_vectors, axes=1))
        candidates.append(in_camera if in_camera[:, 2].mean() > 0 else -in_camera)
    return candidates


def control_points(points_in_world: Array) -> Array:
    """Return the centroid and a point on each principal axis: (4, 3), or (3, 3) for points on a plane."""
    centroid = points_in_world.mean(axis=0)
    _, extents, axes = np.linalg.svd(points_in_world - centroid, full_matrices=False)
    if extents[1] < OPTIONS.planar_ratio * max(extents[0], 1e-12):
        raise DegenerateGeometryError("The points lie on one line, about which the camera could turn.")
    dimensions = 2 if extents[2] < OPTIONS.planar_ratio * extents[0] else 3
    lengths = extents[:dimensions, None] / np.sqrt(len(points_in_world))
    return np.vstack([centroid, centroid + lengths * axes[:dimensions]])


def barycentric_weights(points_in_world: Array, control_in_world: Array) -> Array:
    """Return the weights (n, 4) or (n, 3), each row with sum 1, of the control points in each point.

    Source: B eq. 8 and 10.
    """
    homogeneous_control = np.vstack([control_in_world.T, np.ones(len(control_in_world))])
    homogeneous_points = np.vstack([points_in_world.T, np.ones(len(points_in_world))])
    return np.asarray(np.linalg.lstsq(homogeneous_control, homogeneous_points, rcond=None)[0].T)


def points_from_control(weights: Array, control: Array) -> Array:
    """Return the points (n, 3) that are sums of control points (m, 3) with weights (n, m) (B eq. 8-9)."""
    return np.asarray(weights @ control)


def projection_equations(normalized: Array, weights: Array) -> Array:
    """Return the matrix (2n, 3m) of which the stacked camera-frame control points are a null vector.

    Rows sum_i a_i (x_i - u z_i) and sum_i a_i (y_i - v z_i) for image-plane coordinates u, v (n, 2) and
    weights a (n, m). Source: B eq. 11-13, with K divided out; its eq. 13 prints a_i twice in the second term.
    """
    count, controls = weights.shape
    rows = np.zeros((count, 2, controls, 3))
    rows[:, 0, :, 0] = rows[:, 1, :, 1] = weights
    rows[:, :, :, 2] = -normalized[:, :, None] * weights[:, None, :]
    return rows.reshape(2 * count, 3 * controls)


def _factors_from_distances(null_vectors: Array, control_in_world: Array, used: int) -> Array:
    """Return the factors (m,) of the null vectors for which the control points have their known distances."""
    first, second = np.array(list(combinations(range(len(control_in_world)), 2))).T
    edges = null_vectors[:, first] - null_vectors[:, second]
    squared = np.sum((control_in_world[first] - control_in_world[second]) ** 2, axis=1)
    factors = np.zeros(len(null_vectors))
    factors[:used] = _linearized_factors(edges[:used], squared)
    for _ in range(OPTIONS.gauss_newton_steps):
        combined = np.tensordot(factors, edges, axes=1)
        jacobian = 2.0 * np.einsum("kpc,pc->pk", edges, combined)
        factors = factors + np.linalg.lstsq(jacobian, squared - np.sum(combined**2, axis=1), rcond=None)[0]
    return factors


def _linearized_factors(edges: Array, squared: Array) -> Array:
    """Return the factors (k,) from their products, in which the squared distances (p,) are linear."""
    pairs = [(k, m) for k in range(len(edges)) for m in range(k, len(edges))]
    columns = [np.sum(edges[k] * edges[m], axis=1) * (1.0 if k == m else 2.0) for k, m in pairs]
    products = np.linalg.lstsq(np.stack(columns, axis=1), squared, rcond=None)[0]
    by_pair = dict(zip(pairs, products, strict=True))
    factors = [np.sqrt(abs(by_pair[0, 0]))]
    for k in range(1, len(edges)):
        # Only relative signs matter; the first factor is taken as positive.
        factors.append(np.copysign(np.sqrt(abs(by_pair[k, k])), by_pair[0, k]))
    return np.array(factors)


def _image_plane_error(points_in_camera: Array, normalized: Array) -> float:
    if (points_in_camera[:, 2] <= 0).any():
        return float("inf")
    return float(np.sum((points_in_camera[:, :2] / points_in_camera[:, 2:] - normalized) ** 2))
