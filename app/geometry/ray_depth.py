"""Depth along a keyframe's rays, refined by where other views with known poses see the same points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# How far a depth sensor's own value is trusted, as a share of the depth (one sigma).
DEPTH_PRIOR_SIGMA = 0.03
# A view's say falls to half where it is off by this much: descriptor matches have a pixel or two of noise.
LOSS_SCALE_PX = 2.0
SIGMA_PX = 1.0


@dataclass(frozen=True, slots=True)
class Observations:
    """Where other views see a keyframe's points: point row (m,), undistorted image-plane x, y (m, 2) and focal
    length in pixels (m,) of the view, and its `camera_from_world` rotations (m, 3, 3), translations (m, 3)."""

    rows: NDArray[np.intp]
    normalized: Array
    focal_px: Array
    rotations: Array
    translations: Array

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True, slots=True)
class RefinedDepth:
    """Depths (n,) in metres, their sigma (n,) in metres, and the median error (n,) in pixels of the other views
    at that depth (NaN for points no other view sees)."""

    depth_m: Array
    sigma_m: Array
    error_px: Array
    views: NDArray[np.intp]


def refine_depth_along_rays(
    rays_in_world: Array,
    origin_in_world: Array,
    depth_m: Array,
    seen: Observations,
    steps: int = 8,
    prior_sigma: float = DEPTH_PRIOR_SIGMA,
) -> RefinedDepth:
    """Return the depths that agree best with the sensor and with all other views.

    For each point the unknown is one number, the logarithm s of its depth along its ray: Gauss-Newton on
    `sum_j rho(|u_j(s) - p_j|^2) + ((s - s_sensor) / prior_sigma)^2` with a Cauchy loss rho, all points at once.
    `rays_in_world` (n, 3) are directions scaled to z = 1 in the keyframe's camera, so that
    `origin_in_world + depth * ray` is the point. Triangulation takes out the sensor's systematic error and what
    depth and colour images are misaligned by; the prior keeps points that are seen without parallax.
    """
    n = len(depth_m)
    log_depth = np.log(depth_m)
    start = log_depth.copy()
    prior = (SIGMA_PX / prior_sigma) ** 2
    along = np.einsum("mij,mj->mi", seen.rotations, rays_in_world[seen.rows])
    offset = np.einsum("mij,j->mi", seen.rotations, origin_in_world) + seen.translations
    information = np.full(n, prior)
    for _ in range(steps):
        residual, jacobian = _residuals(log_depth, along, offset, seen)
        weight = 1.0 / (1.0 + np.sum(residual**2, axis=1) / LOSS_SCALE_PX**2)
        information = prior + np.bincount(seen.rows, weight * np.sum(jacobian**2, axis=1), n)
        gradient = np.bincount(seen.rows, weight * np.sum(jacobian * residual, axis=1), n)
        step = (gradient + prior * (log_depth - start)) / information
        log_depth = log_depth - np.clip(step, -0.2, 0.2)
    residual, _ = _residuals(log_depth, along, offset, seen)
    refined = np.exp(log_depth)
    views = np.bincount(seen.rows, minlength=n)
    errors = median_by_row(seen.rows, np.linalg.norm(residual, axis=1), n)
    return RefinedDepth(refined, refined * SIGMA_PX / np.sqrt(information), errors, views)


def _residuals(log_depth: Array, along: Array, offset: Array, seen: Observations) -> tuple[Array, Array]:
    """Pixel residuals (m, 2) and their derivatives (m, 2) by the log depth of the point."""
    change = along * np.exp(log_depth[seen.rows])[:, None]
    points = change + offset
    z = np.maximum(points[:, 2:], 1e-3)
    ratio = points[:, :2] / z
    focal = seen.focal_px[:, None]
    return focal * (ratio - seen.normalized), focal * (change[:, :2] - ratio * change[:, 2:]) / z


def median_by_row(rows: NDArray[np.intp], values: Array, n: int) -> Array:
    """Return the median (n,) of the values (m,) that belong to each row, NaN for a row without any."""
    out = np.full(n, np.nan)
    if len(rows) == 0:
        return out
    order = np.lexsort((values, rows))
    counts = np.bincount(rows, minlength=n)
    starts = np.cumsum(counts) - counts
    has = counts > 0
    low, high = starts[has] + (counts[has] - 1) // 2, starts[has] + counts[has] // 2
    ranked = values[order]
    out[has] = 0.5 * (ranked[low] + ranked[high])
    return out
