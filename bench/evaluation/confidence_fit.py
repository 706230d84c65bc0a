"""Fits the model of confidence to the outcomes of evaluations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from app.engine.query.verification import ConfidenceModel, Evidence, features_of
from app.errors import InvalidInputError
from bench.evaluation.pose_errors import RIGHT_DEG, RIGHT_M, QueryOutcome

# Poses with fewer inliers are refused whatever their confidence.
MIN_INLIERS = 8
# Keeps weights finite where the poses are separable.
RIDGE = 1e-4


@dataclass(frozen=True, slots=True)
class ConfidenceFit:
    """The fitted model, and on how many `poses`, of which `right` were within 0.5 m and 5 degrees; `log_loss` is
    the mean negative logarithm of the probability of what was the case."""

    model: ConfidenceModel
    poses: int
    right: int
    log_loss: float


def fit_confidence(outcomes: Sequence[QueryOutcome]) -> ConfidenceFit:
    """Fit by maximum likelihood to every pose that was judged, trusted or not.

    Raises `InvalidInputError` without both right and wrong poses.
    """
    judged = [o for o in outcomes if o.candidate_deg is not None and o.inliers >= MIN_INLIERS]
    right = np.array([_is_right(o) for o in judged], dtype=bool)
    if right.all() or not right.any():
        raise InvalidInputError(
            "A fit needs poses that are right and poses that are wrong: evaluate absent places as well."
        )
    rows = np.array([features_of(_evidence(o)) for o in judged])
    weights = _logistic(rows, right)
    scores = weights[0] + rows @ weights[1:]
    loss = float(np.logaddexp(0, -np.where(right, scores, -scores)).mean())
    a, b, c, d, e = (round(float(w), 2) for w in weights[1:])
    model = ConfidenceModel(round(float(weights[0]), 2), (a, b, c, d, e))
    return ConfidenceFit(model, len(judged), int(right.sum()), round(loss, 4))


def _logistic(rows: NDArray[np.float64], right: NDArray[np.bool_]) -> NDArray[np.float64]:
    design = np.column_stack([np.ones(len(rows)), rows])
    signs = np.where(right, 1.0, -1.0)

    def loss(weights: NDArray[np.float64]) -> float:
        return float(np.logaddexp(0, -signs * (design @ weights)).mean() + RIDGE * (weights[1:] ** 2).sum())

    return np.asarray(minimize(loss, np.zeros(design.shape[1])).x)


def _is_right(outcome: QueryOutcome) -> bool:
    if outcome.candidate_m is None or outcome.candidate_deg is None:
        return False
    return outcome.candidate_m < RIGHT_M and outcome.candidate_deg < RIGHT_DEG


def _evidence(outcome: QueryOutcome) -> Evidence:
    sigma_m = float("inf") if outcome.position_sigma_m is None else outcome.position_sigma_m
    return Evidence(
        matches=outcome.matches,
        inliers=outcome.inliers,
        coverage=outcome.coverage or 0.0,
        distinct=round((outcome.distinct_share or 0.0) * outcome.inliers),
        rival=round((outcome.rival_share or 0.0) * outcome.inliers),
        keyframe_distance_m=0.0,
        position_sigma_m=sigma_m,
    )
