"""Fits the models of confidence to the outcomes of evaluations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from app.engine.query.placed import Accuracy
from app.engine.query.verification import (
    CameraModel,
    ConfidenceModel,
    Evidence,
    camera_features_of,
    confidence_with,
    features_of,
)
from app.errors import InvalidInputError
from bench.evaluation.pose_errors import RIGHT_DEG, RIGHT_M, QueryOutcome
from bench.evaluation.reliability import POOLED, Reliability, measure_reliability, scene_of

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
    """Fit by maximum likelihood to every pose that was judged, trusted or not, by a camera that nothing speaks against.

    Raises `InvalidInputError` without both right and wrong poses.
    """
    judged = [
        o
        for o in outcomes
        if o.candidate_deg is not None and o.inliers >= MIN_INLIERS and o.camera_trust in (None, "confirmed")
    ]
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


@dataclass(frozen=True, slots=True)
class CameraFit:
    """The fitted model of answers whose camera is not confirmed, of how many `answers`, and how many were `right`."""

    model: CameraModel
    answers: int
    right: int


def fit_camera_confidence(outcomes: Sequence[QueryOutcome]) -> CameraFit:
    """Fit by maximum likelihood to the located queries whose camera the matches don't confirm.

    Raises `InvalidInputError` without both right and wrong ones.
    """
    answers = [outcome for outcome in outcomes if _is_open(outcome)]
    right = np.array([outcome.right for outcome in answers], dtype=bool)
    if right.all() or not right.any():
        raise InvalidInputError("A fit needs wrong answers too: evaluate wrong cameras as well.")
    rows = np.array([_camera_features(outcome) for outcome in answers])
    weights = _logistic(rows, right)
    a, b = (round(float(w), 2) for w in weights[1:])
    return CameraFit(CameraModel(round(float(weights[0]), 2), (a, b)), len(answers), int(right.sum()))


def held_out(outcomes: Mapping[str, Sequence[QueryOutcome]]) -> dict[str, Reliability]:
    """Return how reliable the confidence of each scene's answers is, with the model of cameras fitted to the other
    scenes; `outcomes` are by configuration, whose name begins with its scene."""
    by_scene: dict[str, list[QueryOutcome]] = {}
    for name, own in outcomes.items():
        by_scene.setdefault(scene_of(name), []).extend(own)
    measured, together = {}, list[QueryOutcome]()
    for scene, own in by_scene.items():
        others = [outcome for other, group in by_scene.items() if other != scene for outcome in group]
        model = fit_camera_confidence(others).model
        judged = [_judged_by(model, outcome) for outcome in own]
        measured[scene] = measure_reliability(judged)
        together += judged
    return {**measured, POOLED: measure_reliability(together)}


def _judged_by(model: CameraModel, outcome: QueryOutcome) -> QueryOutcome:
    """Return an outcome with the confidence that another model of cameras gives it."""
    if outcome.sigma_m is None or outcome.camera_trust is None or not _is_open(outcome):
        return outcome
    accuracy = Accuracy(outcome.sigma_m, outcome.sigma_deg or 0.0)
    confidence = confidence_with(_evidence(outcome), accuracy, outcome.camera_trust, model)
    return replace(outcome, confidence=confidence)


def _is_open(outcome: QueryOutcome) -> bool:
    return outcome.located and outcome.camera_trust not in (None, "confirmed") and outcome.sigma_m is not None


def _camera_features(outcome: QueryOutcome) -> NDArray[np.float64]:
    return camera_features_of(
        outcome.inlier_ratio or 0.0, outcome.sigma_m or 0.0, outcome.camera_trust or "open"
    )


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
