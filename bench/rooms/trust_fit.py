"""Fits the model of trust to poses that were judged in several rooms, and says what it does in a room left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from app.engine.query.trust import SPEAKS_FOR, TrustModel, terms_of
from app.engine.query.verification import Evidence
from app.errors import InvalidInputError
from bench.evaluation.pose_errors import QueryOutcome
from bench.rooms.compare import candidate_is_right

# Poses with fewer inliers are refused before the model is asked.
MIN_INLIERS = 10
# Keeps the weights of standardised terms finite where the poses are separable.
RIDGE = 2e-3

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Judged:
    """The terms (n, t) of poses and whether each is right (n,)."""

    terms: Array
    right: Mask

    @staticmethod
    def of(outcomes: Sequence[QueryOutcome]) -> Judged:
        """Return the poses among outcomes that the model would be asked of."""
        asked = [o for o in outcomes if o.candidate_deg is not None and o.inliers >= MIN_INLIERS]
        terms = [terms_of(evidence_from(outcome)) for outcome in asked]
        right = [candidate_is_right(outcome) for outcome in asked]
        return Judged(np.array(terms).reshape(-1, len(SPEAKS_FOR)), np.array(right, dtype=bool))

    @staticmethod
    def join(parts: Sequence[Judged]) -> Judged:
        """Return the poses of all parts."""
        return Judged(np.concatenate([p.terms for p in parts]), np.concatenate([p.right for p in parts]))


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """What the model of the other rooms says of a room's poses: how many there are and are right, the mean distance of
    probability and truth in bins, and at a risk how many it would answer, rightly and wrongly."""

    room: str
    poses: int
    right: int
    calibration_error: float
    answered_right: int
    answered_wrong: int


def evidence_from(outcome: QueryOutcome) -> Evidence:
    """Return the evidence of an outcome, as far as the model's terms need it."""
    inliers = outcome.inliers
    unrepeated = outcome.unrepeated_share
    return Evidence(
        matches=outcome.matches,
        inliers=inliers,
        coverage=outcome.coverage or 0.0,
        distinct=round((outcome.distinct_share or 0.0) * inliers),
        rival=round((outcome.rival_share or 0.0) * inliers),
        position_sigma_m=float("inf") if outcome.position_sigma_m is None else outcome.position_sigma_m,
        unrepeated=None if unrepeated is None else round(unrepeated * inliers),
        contradicted=outcome.contradicted_share or 0.0,
        distinct_cells=outcome.distinct_cells or 0.0,
    )


def fit_trust(judged: Judged) -> TrustModel:
    """Fit by maximum likelihood, right and wrong poses with the same total weight; no weight may have another sign than
    its term's meaning. Raises `InvalidInputError` without both right and wrong poses."""
    if judged.right.all() or not judged.right.any():
        raise InvalidInputError("A fit needs poses that are right and poses that are wrong: add look-alikes.")
    centre, scale = judged.terms.mean(axis=0), judged.terms.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(judged.terms)), (judged.terms - centre) / scale])
    signs = np.where(judged.right, 1.0, -1.0)
    share = np.where(judged.right, 0.5 / judged.right.sum(), 0.5 / (~judged.right).sum())

    def loss(weights: Array) -> float:
        likelihood = share @ np.logaddexp(0, -signs * (design @ weights))
        return float(likelihood + RIDGE * (weights[1:] ** 2).sum())

    bounds = [(None, None), *((0, None) if speaks_for else (None, 0) for speaks_for in SPEAKS_FOR)]
    found = minimize(loss, np.zeros(design.shape[1]), method="L-BFGS-B", bounds=bounds).x
    weights = found[1:] / scale
    typical = np.median(judged.terms[judged.right], axis=0)
    return TrustModel(
        round(float(found[0] - weights @ centre), 3),
        tuple(round(float(w), 3) for w in weights),
        tuple(round(float(t), 3) for t in typical),
    )


def leave_one_out(rooms: Mapping[str, Judged], max_risk: float) -> list[LeftOut]:
    """Return, for every room, what the model of the others says of it."""
    found = []
    for room, own in rooms.items():
        model = fit_trust(Judged.join([other for name, other in rooms.items() if name != room]))
        probability = probabilities(model, own)
        answered = 1.0 - probability <= max_risk
        found.append(
            LeftOut(
                room=room,
                poses=len(own.right),
                right=int(own.right.sum()),
                calibration_error=calibration_error(probability, own.right),
                answered_right=int((answered & own.right).sum()),
                answered_wrong=int((answered & ~own.right).sum()),
            )
        )
    return found


def probabilities(model: TrustModel, judged: Judged) -> Array:
    """Return the model's probability (n,) of each pose."""
    return np.asarray(1.0 / (1.0 + np.exp(-(model.intercept + judged.terms @ np.array(model.weights)))))


def calibration_error(probability: Array, right: Mask, bins: int = 10) -> float:
    """Return the mean distance of the mean probability and the share that is right, over bins of equal count."""
    if not len(right):
        return 0.0
    parts = np.array_split(np.argsort(probability), min(bins, len(right)))
    errors = [len(part) * abs(probability[part].mean() - right[part].mean()) for part in parts]
    return round(float(sum(errors) / len(right)), 4)
