"""The probability that a pose is right, by all that speaks for and against it.

A logistic model whose weights are fitted to poses in several rooms (`roomfix fit-trust`). What speaks for a pose are
counts and covered parts of the picture, not shares: a room may have any number of things that resemble each other, as
long as enough others agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.engine.query.verification import Evidence, Limits, Reason
from app.limits import limit

Kind = Literal["too_few_inliers", "ambiguous"]

# Each term, and the reason of a refusal that it is most to blame for.
TERMS: dict[str, Kind] = {
    "inliers": "too_few_inliers",
    "distinct inliers": "ambiguous",
    "unrepeated inliers": "ambiguous",
    "distinct coverage": "ambiguous",
    "coverage": "too_few_inliers",
    "inlier ratio": "too_few_inliers",
    "precision": "too_few_inliers",
    "rival": "ambiguous",
    "contradiction": "ambiguous",
}
# Whether a term speaks for a pose or against it.
SPEAKS_FOR = tuple(name not in ("rival", "contradiction") for name in TERMS)


@dataclass(frozen=True, slots=True, kw_only=True)
class TermOptions:
    """Beyond which value more evidence of a kind counts no more."""

    most_inliers: int = limit(
        150,
        "Inliers, of any kind, beyond which more say nothing new.",
        chosen="By hand: no place has as many by chance.",
    )
    most_coverage: float = limit(
        0.5, "Coverage beyond which more says nothing new.", chosen="By hand: half of the picture."
    )
    least_sigma_m: float = limit(
        0.01, "Position sigma below which less says nothing new.", chosen="By hand: the error of a good map."
    )
    most_sigma_m: float = limit(
        1.0, "Position sigma beyond which more says nothing new.", chosen="By hand: it is refused far below."
    )
    least_inlier_ratio: float = limit(
        0.02,
        "Ratio of inliers to matches below which less says nothing new.",
        chosen="By hand: refused above it.",
    )


OPTIONS = TermOptions()


def terms_of(evidence: Evidence) -> NDArray[np.float64]:
    """Return the terms of the model, in the order of `TERMS`; each grows with what it is named after."""
    most = OPTIONS.most_inliers
    unrepeated = evidence.distinct if evidence.unrepeated is None else evidence.unrepeated
    sigma_m = float(np.clip(evidence.position_sigma_m, OPTIONS.least_sigma_m, OPTIONS.most_sigma_m))
    return np.array(
        [
            np.log2(1 + min(evidence.inliers, most)),
            np.log2(1 + min(evidence.distinct, most)),
            np.log2(1 + min(unrepeated, most)),
            min(evidence.distinct_cells, OPTIONS.most_coverage),
            min(evidence.coverage, OPTIONS.most_coverage),
            np.log2(max(evidence.inlier_ratio, OPTIONS.least_inlier_ratio)),
            -np.log10(sigma_m),
            evidence.rival / max(evidence.inliers, 1),
            evidence.contradicted,
        ]
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorOptions:
    """What a pose needs before the model is asked: below, its probability means nothing."""

    min_coverage: float = limit(
        0.1,
        "Least share of the picture's grid cells that hold inliers.",
        chosen="By hand: below it poses at the right place are often half a metre off (docs/figures/fit-trust.md).",
    )


FLOORS = FloorOptions()


@dataclass(frozen=True, slots=True)
class TrustModel:
    """A logistic model of `terms_of`; `typical` are the terms of an ordinary right pose, which a refused one is
    compared with to say what it lacks."""

    intercept: float
    weights: tuple[float, ...]
    typical: tuple[float, ...]

    def __call__(self, evidence: Evidence) -> float:
        """Return the probability that the pose is off by less than 0.5 m and 5 degrees."""
        score = self.intercept + float(np.dot(self.weights, terms_of(evidence)))
        return float(1.0 / (1.0 + np.exp(-score)))

    def blames(self, evidence: Evidence) -> Reason:
        """Return the reason that explains most of what the evidence lacks."""
        lack = np.array(self.weights) * (np.array(self.typical) - terms_of(evidence))
        totals = {
            kind: sum(value for value, own in zip(lack, TERMS.values(), strict=True) if own == kind)
            for kind in ("too_few_inliers", "ambiguous")
        }
        return "ambiguous" if totals["ambiguous"] > totals["too_few_inliers"] else "too_few_inliers"


TRUST = TrustModel(0.0, (0.0,) * len(TERMS), (0.0,) * len(TERMS))


def trust_of(evidence: Evidence) -> float:
    """Return the probability that a pose with this evidence is off by less than 0.5 m and 5 degrees."""
    return TRUST(evidence) if evidence.inliers else 0.0


def refused_outright(evidence: Evidence, position_sigma_m: float, limits: Limits) -> Reason | None:
    """Return why a pose can't be trusted whatever else speaks for it; `position_sigma_m` has the map's error in it."""
    inliers = evidence.inliers
    failed: tuple[tuple[bool, Reason], ...] = (
        (evidence.matches < limits.min_inliers, "no_match"),
        (inliers < limits.min_inliers, "too_few_inliers"),
        (evidence.coverage < min(FLOORS.min_coverage, limits.min_coverage), "too_few_inliers"),
        (position_sigma_m > limits.max_position_sigma_m, "too_few_inliers"),
        (evidence.rival > limits.max_rival_share * inliers, "ambiguous"),
        (evidence.keyframe_distance_m > limits.max_keyframe_distance_m, "outside_venue"),
    )
    return next((reason for fails, reason in failed if fails), None)


def judge_by_trust(evidence: Evidence, limits: Limits) -> Reason | None:
    """Return why a pose is too likely to be wrong, or None if it can be trusted."""
    probability = trust_of(evidence)
    if 1.0 - probability <= limits.max_risk and probability >= limits.min_confidence:
        return None
    return TRUST.blames(evidence)
