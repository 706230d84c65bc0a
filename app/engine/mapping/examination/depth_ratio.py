"""Depth that the poses triangulate, over the sensor's depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.agreement import (
    Rays,
    epipolar_errors,
    group_medians,
    relative_poses,
    triangulated,
    wide_matches,
)
from app.engine.mapping.examination.evidence import Evidence
from app.engine.mapping.examination.limits import LIMITS
from app.geometry.camera import REFERENCE_FOCAL_PX
from app.importers.conventions import PoseArrays
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthRatioOptions:
    """When depth can be compared."""

    min_matches: int = limit(
        40, "Triangulated matches with depth that make a ratio.", chosen="By hand: two pairs' worth."
    )
    shared_ratio: float = limit(
        0.5, "Part of what is wrong with a pair's depth that all pairs share.", chosen="By hand: half of it."
    )
    apart_log: float = limit(
        0.35,
        "A pair whose logarithm of the ratio differs by more than this from the usual one has another scale.",
        chosen="By hand: a third, more than drift and sensors make.",
    )
    pair_sigma: float = limit(
        0.02, "What a pair's own depth and poses leave in the logarithm of its ratio.", chosen="By hand."
    )


OPTIONS = DepthRatioOptions()


@dataclass(frozen=True, slots=True)
class DepthRatio:
    """Triangulated over measured depth: the weighted median `ratio`, and `sigma` of its logarithm.

    `depth_m` is the usual depth of the sensor, `apart_share` the share of pairs that have another ratio, by more than
    their own sigmas.
    """

    ratio: float
    sigma: float
    depth_m: float
    matches: int
    apart_share: float = 0.0


def measure_depth_ratio(evidence: Evidence, rays: Rays, poses: PoseArrays) -> DepthRatio | None:
    """Return the ratio of triangulated to measured depth, None where too little is triangulated."""
    relative = relative_poses(evidence, poses)
    errors_px = epipolar_errors(evidence, rays, relative) * REFERENCE_FOCAL_PX
    of_pairs = np.maximum(group_medians(errors_px, evidence.pair, evidence.pairs), LIMITS.min_noise_px)
    first_m, second_m, parallax = triangulated(evidence, rays, relative)
    wide, pair_sigmas = wide_matches(evidence, parallax * REFERENCE_FOCAL_PX, of_pairs)
    sides = [
        _compared(first_m, evidence.first_m, wide, evidence.pair),
        _compared(second_m, evidence.second_m, wide, evidence.pair),
    ]
    logs, pair, measured = (np.concatenate(part) for part in zip(*sides, strict=True))
    if len(logs) < OPTIONS.min_matches:
        return None
    order = np.argsort(pair, kind="stable")
    medians = group_medians(logs[order], pair[order], evidence.pairs)
    known = np.isfinite(medians)
    sigmas = np.hypot(OPTIONS.pair_sigma, pair_sigmas[known])
    log_ratio = _weighted_median(medians[known], 1.0 / sigmas)
    scatter = 1.48 * float(np.median(np.abs(medians[known] - log_ratio)) / np.sqrt(np.count_nonzero(known)))
    return DepthRatio(
        ratio=float(np.exp(log_ratio)),
        sigma=_sigma(sigmas, scatter),
        depth_m=float(np.median(measured)),
        matches=len(logs),
        apart_share=float(
            np.mean(np.abs(medians[known] - log_ratio) > np.maximum(OPTIONS.apart_log, 3 * sigmas))
        ),
    )


def _compared(
    depth_m: Array, sensor_m: Array, wide: Mask, pair: NDArray[np.intp]
) -> tuple[Array, NDArray[np.intp], Array]:
    kept = wide & (depth_m > 0) & (sensor_m > 0)
    logs = np.log(depth_m[kept] / sensor_m[kept])
    return logs, pair[kept], sensor_m[kept]


def _sigma(of_pairs: Array, scatter: float) -> float:
    """Return the sigma of the median of pairs with sigmas (p,) that scatter so much about it."""
    by_chance = 1.25 * max(float(1.0 / np.sqrt(np.sum(1.0 / of_pairs**2))), scatter)
    # Late clocks and rolling shutters are wrong the same way in every pair.
    return float(np.hypot(by_chance, OPTIONS.shared_ratio * np.median(of_pairs)))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
