"""Depth along a keyframe's rays, refined by the pixels of the same points in other views with known poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.reprojection import PIXEL_NOISE
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class RayDepthOptions:
    """How depths are refined by other views."""

    prior_sigma_ratio: float = limit(
        0.03,
        "Standard deviation of a depth sensor's value, relative to the depth.",
        chosen="By hand: the systematic and random errors of RGB-D cameras.",
    )
    steps: int = limit(
        8,
        "Gauss-Newton steps.",
        chosen="By hand: meant to be enough to converge.",
    )
    max_log_step: float = limit(
        0.2,
        "Largest change of a depth's logarithm in one step.",
        chosen="By hand: keeps a depth from leaving the range in which its derivative is meaningful.",
    )
    min_depth_m: float = limit(
        1e-3,
        "Lower bound of a point's depth in another view.",
        chosen="By hand: avoids a division by zero.",
    )


OPTIONS = RayDepthOptions()


@dataclass(frozen=True, slots=True)
class Observations:
    """The pixels of a keyframe's points in other views.

    For each observation: the row of the point (m,), its undistorted image-plane x, y (m, 2), and of the view the
    focal length in pixels (m,) and the `camera_from_world` rotation (m, 3, 3) and translation (m, 3).
    """

    rows: NDArray[np.intp]
    normalized: Array
    focal_px: Array
    rotations: Array
    translations: Array

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True, slots=True)
class RefinedDepth:
    """Refined depths (n,) in metres, their standard deviations (n,) in metres, the median reprojection error (n,) in
    pixels in the other views (NaN for points that no other view sees), and the number of these views (n,)."""

    depth_m: Array
    sigma_m: Array
    error_px: Array
    views: NDArray[np.intp]


def refine_depth_along_rays(
    rays_in_world: Array,
    origin_in_world: Array,
    depth_m: Array,
    seen: Observations,
    steps: int = OPTIONS.steps,
    prior_sigma: float = OPTIONS.prior_sigma_ratio,
) -> RefinedDepth:
    """Return the depths that agree best with the sensor's depths (n,) and with all other views.

    The only unknown of a point is the logarithm s of its depth along its ray: Gauss-Newton, for all points at once,
    on `sum_j rho(|u_j(s) - p_j|^2) + ((s - s_sensor) / prior_sigma)^2` with a Cauchy loss rho. `rays_in_world` (n, 3)
    are directions scaled to z = 1 in the keyframe's camera, so that `origin_in_world + depth * ray` is the point.
    Triangulation removes the sensor's systematic error and the misalignment of depth and colour images; the prior
    determines the depth of points without parallax.
    """
    n = len(depth_m)
    log_depth = np.log(depth_m)
    start = log_depth.copy()
    prior = (PIXEL_NOISE.sigma_px / prior_sigma) ** 2
    along = np.einsum("mij,mj->mi", seen.rotations, rays_in_world[seen.rows])
    offset = np.einsum("mij,j->mi", seen.rotations, origin_in_world) + seen.translations
    information = np.full(n, prior)
    for _ in range(steps):
        residual, jacobian = _residuals(log_depth, along, offset, seen)
        weight = 1.0 / (1.0 + np.sum(residual**2, axis=1) / PIXEL_NOISE.loss_scale_px**2)
        information = prior + np.bincount(seen.rows, weight * np.sum(jacobian**2, axis=1), n)
        gradient = np.bincount(seen.rows, weight * np.sum(jacobian * residual, axis=1), n)
        step = (gradient + prior * (log_depth - start)) / information
        log_depth = log_depth - np.clip(step, -OPTIONS.max_log_step, OPTIONS.max_log_step)
    residual, _ = _residuals(log_depth, along, offset, seen)
    refined = np.exp(log_depth)
    views = np.bincount(seen.rows, minlength=n)
    errors = median_by_row(seen.rows, np.linalg.norm(residual, axis=1), n)
    sigma_m = refined * PIXEL_NOISE.sigma_px / np.sqrt(information)
    return RefinedDepth(refined, sigma_m, errors, views)


def _residuals(log_depth: Array, along: Array, offset: Array, seen: Observations) -> tuple[Array, Array]:
    """Return the reprojection errors (m, 2) in pixels and their derivatives (m, 2) by the log depth of the point."""
    change = along * np.exp(log_depth[seen.rows])[:, None]
    points = change + offset
    z = np.maximum(points[:, 2:], OPTIONS.min_depth_m)
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
