"""From counted pairs of frames to fitted curves and keyframe thresholds (A 2.1, eq. 1-3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.limits import limit
from app.vision.keyframes import PoseThresholds, PowerLaw, thresholds_for_matches
from app.vision.power_law import Reached, fit_near, rmse, threshold_within

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveOptions:
    """Which pairs of frames a curve is fitted to, and when the two thresholds have converged."""

    min_position_m: float = limit(
        0.01,
        "Smallest position difference of a pair that the position curve is fitted to.",
        chosen="By hand: smaller differences are within the noise of a tracked pose (docs/calibration.md).",
    )
    min_attitude_rad: float = limit(
        0.01,
        "Smallest attitude difference of a pair that the attitude curve is fitted to.",
        chosen="By hand: smaller differences are within the noise of a tracked pose (docs/calibration.md).",
    )
    min_pairs: int = limit(
        12,
        "Least number of pairs that a curve is fitted to; with fewer the calibration fails.",
        chosen="By hand; no measurement is recorded.",
    )
    enough_pairs: int = limit(
        40,
        "Number of pairs wanted for a fit: with fewer, pairs that differ more in the other respect are added.",
        chosen="By hand; no measurement is recorded.",
    )
    max_rounds: int = limit(
        12,
        "Largest number of rounds in which the two thresholds are found in turns.",
        chosen="By hand: the thresholds depend on each other only a little, so that a few rounds are enough.",
    )
    max_log_change: float = limit(
        0.01,
        "Change of the thresholds' logarithms in one round below which they have converged.",
        chosen="By hand: about one percent, far below the scatter between seeds (docs/calibration.md).",
    )
    near_threshold_ratio: float = limit(
        1.25,
        "Largest ratio between a held-back pair's difference and the threshold, for the median at the threshold.",
        chosen="By hand; no measurement is recorded.",
    )
    min_held_back_pairs: int = limit(
        3,
        "Least number of held-back pairs near the threshold for that median.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = CurveOptions()


@dataclass(frozen=True, slots=True)
class PairCounts:
    """Pairs of frames, all (n,): differences in position (m) and attitude (rad), numbers of verified matches, and
    whether a pair is held back from the fit."""

    position_m: Array
    attitude_rad: Array
    matches: NDArray[np.int64]
    held_back: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedCurve:
    """One curve: number of matches over a difference in metres or radians.

    `range` is an interval of differences around the threshold. The curve is fitted to the pairs inside it, and both
    RMSE, in matches, are over these pairs. `other_limit` is the largest difference in the other respect that these
    pairs may have. `left_at_threshold` is the median number of matches of the held-back pairs near the threshold,
    None where there are too few. `differences`, `matches` and `held_back` are of all pairs, also outside of the range.
    """

    curve: PowerLaw
    threshold: float
    reached: Reached
    range: tuple[float, float]
    other_limit: float
    rmse_fit: float
    rmse_validation: float | None
    left_at_threshold: float | None
    differences: Array
    matches: NDArray[np.int64]
    held_back: NDArray[np.bool_]
    pairs_fit: int
    pairs_validation: int

    def as_dict(self, points: bool = True) -> dict[str, Any]:
        """Return the figures for JSON, with the data points if wanted."""
        figures: dict[str, Any] = {
            "a": round(self.curve.a, 4),
            "b": round(self.curve.b, 4),
            "rmse_fit": round(self.rmse_fit, 2),
            "rmse_validation": _rounded(self.rmse_validation, 2),
            "pairs_fit": self.pairs_fit,
            "pairs_validation": self.pairs_validation,
            "threshold": round(self.threshold, 4),
            "reached": self.reached,
            "left_at_threshold": _rounded(self.left_at_threshold, 1),
            "range": [round(value, 4) for value in self.range],
            "other_limit": round(self.other_limit, 4),
        }
        if points:
            figures["points"] = [
                {"difference": round(float(x), 4), "matches": int(y), "held_back": bool(held)}
                for x, y, held in zip(self.differences, self.matches, self.held_back, strict=True)
            ]
        return figures


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """Both curves of a scan and the thresholds that follow from them; `warnings` are sentences for people."""

    wanted_matches: float
    features: str
    frames: int
    position: FittedCurve
    attitude: FittedCurve
    warnings: tuple[str, ...]

    @property
    def thresholds(self) -> PoseThresholds:
        """The pose differences at which the wanted matches are left."""
        return PoseThresholds(self.position.threshold, self.attitude.threshold)

    def as_dict(self, points: bool = True) -> dict[str, Any]:
        """Return the figures for JSON, with the data points if wanted."""
        return {
            "wanted_matches": self.wanted_matches,
            "features": self.features,
            "frames": self.frames,
            "thresholds": {
                "position_m": round(self.thresholds.position_m, 4),
                "attitude_rad": round(self.thresholds.attitude_rad, 4),
            },
            "position": self.position.as_dict(points),
            "attitude": self.attitude.as_dict(points),
            "warnings": list(self.warnings),
        }


def fit_curves(pairs: PairCounts, wanted_matches: float, features: str, frames: int) -> Calibration:
    """Fit both curves and derive the thresholds that leave `wanted_matches` matches (A eq. 1-3).

    In a hand-held scan position and attitude change together: two frames that are a metre apart mostly look in
    different directions as well. A curve over all pairs would describe how the camera was carried. A frame is no
    keyframe when it is close to one in *both* respects. So the position curve is fitted to the pairs whose attitude
    difference is within the attitude threshold, and the attitude curve to the pairs whose position difference is
    within the position threshold. The two thresholds are found in turns, starting from the paper's, until they
    converge.

    Raises `InvalidScanError` when there are too few pairs, or none with a verified match.
    """
    if not np.any(pairs.matches[~pairs.held_back] > 0):
        raise InvalidScanError(
            "No two frames of the scan have a match that its depth and poses confirm: check camera, depth_scale "
            "and the poses."
        )
    start = thresholds_for_matches()
    limits = start.position_m, start.attitude_rad
    for _ in range(OPTIONS.max_rounds):
        position = _fit(
            pairs, pairs.position_m, OPTIONS.min_position_m, pairs.attitude_rad, limits[1], wanted_matches
        )
        attitude = _fit(
            pairs, pairs.attitude_rad, OPTIONS.min_attitude_rad, pairs.position_m, limits[0], wanted_matches
        )
        # The geometric mean with the last round keeps the two from oscillating.
        settled = math.sqrt(limits[0] * position.threshold), math.sqrt(limits[1] * attitude.threshold)
        change = max(abs(math.log(new / old)) for new, old in zip(settled, limits, strict=True))
        limits = settled
        if change < OPTIONS.max_log_change:
            break
    notes = [
        *_warnings(position, wanted_matches, "position", "m"),
        *_warnings(attitude, wanted_matches, "attitude", "rad"),
    ]
    return Calibration(
        wanted_matches=wanted_matches,
        features=features,
        frames=frames,
        position=position,
        attitude=attitude,
        warnings=tuple(notes),
    )


def _fit(
    pairs: PairCounts, difference: Array, smallest: float, other: Array, limit: float, wanted_matches: float
) -> FittedCurve:
    distinct = difference >= smallest
    limit = _limit_for_enough(other[distinct & ~pairs.held_back], limit)
    chosen = distinct & (other <= limit)
    x, y, held = difference[chosen], pairs.matches[chosen], pairs.held_back[chosen]
    if (~held).sum() < OPTIONS.min_pairs:
        raise InvalidScanError(
            f"The scan has only {int((~held).sum())} pairs of frames to fit a curve to, and {OPTIONS.min_pairs} are "
            "needed: scan more frames, or give keyframes.position_m and keyframes.attitude_rad."
        )
    fit = fit_near(x[~held], y[~held], wanted_matches)
    threshold = threshold_within(fit.curve, wanted_matches, float(x[~held].min()), float(x[~held].max()))
    within = (x >= fit.low) & (x <= fit.high)
    fitted, checked = within & ~held, within & held
    return FittedCurve(
        curve=fit.curve,
        threshold=threshold.value,
        reached=threshold.reached,
        range=(fit.low, fit.high),
        other_limit=limit,
        rmse_fit=rmse(fit.curve, x[fitted], y[fitted]) or 0.0,
        rmse_validation=rmse(fit.curve, x[checked], y[checked]),
        left_at_threshold=_left_around(threshold.value, x[held], y[held]),
        differences=x,
        matches=y,
        held_back=held,
        pairs_fit=int(fitted.sum()),
        pairs_validation=int(checked.sum()),
    )


def _limit_for_enough(other: Array, limit: float) -> float:
    """Return the limit of the other difference, raised where fewer than `OPTIONS.enough_pairs` pairs are below it."""
    if len(other) == 0:
        return limit
    return max(limit, float(np.sort(other)[min(OPTIONS.enough_pairs, len(other)) - 1]))


def _left_around(threshold: float, x: Array, matches: NDArray[np.int64]) -> float | None:
    """Return the median number of matches of the pairs near a threshold, None where there are too few."""
    near = np.abs(np.log(x / threshold)) < np.log(OPTIONS.near_threshold_ratio)
    return float(np.median(matches[near])) if near.sum() >= OPTIONS.min_held_back_pairs else None


def _warnings(fit: FittedCurve, wanted_matches: float, name: str, unit: str) -> Sequence[str]:
    if fit.reached == "beyond":
        return [
            f"Frames as far apart in {name} as the scan has them ({fit.range[1]:.3g} {unit}) still share more than "
            f"{wanted_matches:g} matches; the threshold is that difference."
        ]
    if fit.reached == "below":
        return [
            f"Even frames that differ by {fit.range[0]:.3g} {unit} in {name} share fewer than "
            f"{wanted_matches:g} matches; the threshold is that difference. Ask for fewer matches, or "
            "use other features."
        ]
    return []


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
