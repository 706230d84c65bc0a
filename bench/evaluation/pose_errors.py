"""Errors of estimated poses against the truth, and their summary (A 3.)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from app.engine.query.intrinsics import CameraTrust
from app.errors import InvalidInputError
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m

GROSS_M = 0.5
RIGHT_M = 0.5
RIGHT_DEG = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class QueryOutcome:
    """One query: its errors when it was located, the reason when it was not, and what it took.

    `truth_m` and `estimate_m` are camera centres in the world. The values up to `sigma_deg` are those of
    `Evidence` and `Localization` in `app/engine/query` (None where they aren't known): the features of the model of
    confidence. `candidate_m` and `candidate_deg` are the errors of the pose that was judged, trusted or not.
    """

    name: str
    located: bool
    position_m: float
    orientation_deg: float
    reason: str | None
    inliers: int
    confidence: float
    milliseconds: float
    matches: int = 0
    inlier_ratio: float | None = None
    coverage: float | None = None
    rival_share: float | None = None
    keyframe_distance_m: float | None = None
    sigma_m: float | None = None
    sigma_deg: float | None = None
    truth_m: tuple[float, float, float] | None = None
    estimate_m: tuple[float, float, float] | None = None
    distinct_share: float | None = None
    candidate_m: float | None = None
    candidate_deg: float | None = None
    position_sigma_m: float | None = None
    unrepeated_share: float | None = None
    contradicted_share: float | None = None
    camera_trust: CameraTrust | None = None

    @property
    def right(self) -> bool:
        """Whether it was located within 0.5 m and 5 degrees: what `confidence` is the probability of."""
        return self.located and self.position_m < RIGHT_M and self.orientation_deg < RIGHT_DEG

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome for JSON, which knows no infinity: errors without a pose are null."""
        out = asdict(self)
        if not self.located:
            out["position_m"] = out["orientation_deg"] = None
        return {
            name: None if isinstance(value, float) and not np.isfinite(value) else value
            for name, value in out.items()
        }

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> QueryOutcome:
        """Return the outcome of `as_dict`; raises `InvalidInputError` for anything else."""
        known = {name: value for name, value in values.items() if name in QueryOutcome.__slots__}
        missing = [name for name in QueryOutcome.__slots__[:8] if name not in known]
        if missing:
            raise InvalidInputError(f"The outcome of a query has no {missing[0]!r}.")
        for name in ("position_m", "orientation_deg"):
            known[name] = float("inf") if known[name] is None else float(known[name])
        return QueryOutcome(**known)


def pose_error(estimate: Pose, truth: Pose) -> tuple[float, float]:
    """Return the distance in metres and the angle in degrees between two `world_from_camera`."""
    return position_difference_m(estimate, truth), float(np.degrees(attitude_difference_rad(estimate, truth)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorSummary:
    """Shares are of all queries, located or not; means are of the located ones; medians and the 90 % figures
    count a query that was not located as infinitely far off (null when that makes them infinite). `gross_percent`
    is the share with an error over 0.5 m, `over_1m_percent` over 1 m; `within_25cm_percent` ignores the attitude."""

    queries: int
    located_percent: float
    median_cm: float | None
    median_deg: float | None
    p90_cm: float | None
    p90_deg: float | None
    mean_cm: float | None
    mean_deg: float | None
    within_5cm_5deg_percent: float
    within_10cm_5deg_percent: float
    within_50cm_5deg_percent: float
    within_25cm_percent: float
    gross_percent: float
    over_1m_percent: float
    max_cm: float | None
    reasons: dict[str, int]
    median_ms: float
    p95_ms: float

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def summarize(outcomes: Sequence[QueryOutcome]) -> ErrorSummary:
    """Summarize the outcomes of at least one query."""
    metres = np.array([o.position_m if o.located else np.inf for o in outcomes])
    degrees = np.array([o.orientation_deg if o.located else np.inf for o in outcomes])
    located = np.isfinite(metres)
    times = np.array([o.milliseconds for o in outcomes])

    def within(limit_m: float) -> float:
        return _percent((metres < limit_m) & (degrees < 5.0))

    return ErrorSummary(
        queries=len(outcomes),
        located_percent=_percent(located),
        median_cm=_finite(100 * _quantile(metres, 0.5), 2),
        median_deg=_finite(_quantile(degrees, 0.5), 3),
        p90_cm=_finite(100 * _quantile(metres, 0.9), 2),
        p90_deg=_finite(_quantile(degrees, 0.9), 3),
        mean_cm=_finite(100 * float(metres[located].mean()), 2) if located.any() else None,
        mean_deg=_finite(float(degrees[located].mean()), 3) if located.any() else None,
        within_5cm_5deg_percent=within(0.05),
        within_10cm_5deg_percent=within(0.10),
        within_50cm_5deg_percent=within(0.50),
        within_25cm_percent=_percent(metres < 0.25),
        gross_percent=_percent(located & (metres > GROSS_M)),
        over_1m_percent=_percent(located & (metres > 1.0)),
        max_cm=_finite(100 * float(metres[located].max()), 2) if located.any() else None,
        reasons=dict(Counter(o.reason for o in outcomes if o.reason is not None)),
        median_ms=round(float(np.median(times)), 1),
        p95_ms=round(float(np.percentile(times, 95)), 1),
    )


def _quantile(values: np.ndarray[Any, np.dtype[np.float64]], share: float) -> float:
    # The smallest value that a given share of the queries does not exceed; interpolation with infinity would be NaN.
    ordered = np.sort(values)
    if share == 0.5 and len(ordered) % 2 == 0 and np.isfinite(ordered[len(ordered) // 2]):
        return float(np.median(ordered))
    return float(ordered[max(0, int(np.ceil(share * len(ordered))) - 1)])


def _percent(mask: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
    return round(100.0 * float(np.mean(mask)), 2)


def _finite(value: float, digits: int) -> float | None:
    return round(value, digits) if np.isfinite(value) else None
