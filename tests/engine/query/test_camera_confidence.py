"""Confidence where the matches confirm no stated camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.intrinsics import CameraTrust
from app.engine.query.intrinsics_options import OPTIONS as CAMERA
from app.engine.query.placed import Accuracy
from app.engine.query.verification import (
    CAMERA_CONFIDENCE,
    CameraModel,
    Evidence,
    camera_features_of,
    confidence_of,
    confidence_with,
)

SURE_POSE = Evidence(
    matches=80,
    inliers=64,
    coverage=0.6,
    distinct=56,
    rival=2,
    keyframe_distance_m=1.0,
    position_sigma_m=0.01,
    unrepeated=32,
)
FAR = Accuracy(0.6, 2.0)


def test_confidence_of_a_camera_that_is_not_confirmed_is_a_logistic_model_of_two_features() -> None:
    assert camera_features_of(0.4, 0.1, "refined") == pytest.approx([1.0, 0.0])
    assert camera_features_of(0.4, 0.1, "fitted")[1] == 0.0
    assert camera_features_of(0.4, 0.1, "open")[1] == camera_features_of(0.4, 0.1, "contradicted")[1] == 1.0
    # Where most matches agree with an open camera it may be the right one.
    most = CAMERA.sure_inlier_ratio
    assert camera_features_of(most, 0.1, "open")[1] == 0.0 != camera_features_of(most - 0.01, 0.1, "open")[1]
    assert camera_features_of(most, 0.1, "contradicted")[1] == 1.0
    # The accuracy counts from 1 cm to 2 m.
    assert camera_features_of(0.4, 0.001, "open")[0] == 2.0
    assert camera_features_of(0.4, float("inf"), "open")[0] == pytest.approx(-np.log10(2.0))
    model = CameraModel(0.5, (2.0, -3.0))
    assert model(np.array([1.2, 1.0])) == pytest.approx(1 / (1 + np.exp(-(0.5 + 2.4 - 3.0))))


def test_a_camera_that_is_not_confirmed_can_only_lower_the_confidence() -> None:
    near = Accuracy(0.03, 1.0)
    assert confidence_with(SURE_POSE, FAR, "confirmed") == confidence_of(SURE_POSE)
    assert confidence_with(SURE_POSE, FAR, "refined") < confidence_with(SURE_POSE, near, "refined")
    assert confidence_with(SURE_POSE, near, "contradicted") < confidence_with(SURE_POSE, near, "refined")
    doubtful = replace(SURE_POSE, matches=640, coverage=0.15, distinct=24, rival=40, position_sigma_m=0.15)
    assert confidence_with(doubtful, near, "refined") == confidence_of(doubtful)


FEWER = replace(SURE_POSE, matches=110)


@pytest.mark.parametrize(
    ("pose", "trust"), [(SURE_POSE, "contradicted"), (FEWER, "contradicted"), (FEWER, "open")]
)
def test_a_camera_that_is_contradicted_or_that_few_matches_leave_open_is_never_sure(
    pose: Evidence, trust: CameraTrust
) -> None:
    near = Accuracy(0.01, 0.3)
    features = camera_features_of(pose.inlier_ratio, near.position_m, trust)
    assert min(confidence_of(pose), CAMERA_CONFIDENCE(features)) > CAMERA.unsure_confidence
    assert confidence_with(pose, near, trust) == CAMERA.unsure_confidence < 0.9
    assert confidence_with(pose, near, "refined") > CAMERA.unsure_confidence


def test_an_open_camera_that_most_matches_agree_with_may_be_sure() -> None:
    near = Accuracy(0.15, 1.0)
    assert confidence_with(SURE_POSE, near, "open") == confidence_with(SURE_POSE, near, "refined") > 0.95


def test_an_answer_by_another_camera_that_may_be_half_a_metre_off_is_never_sure() -> None:
    vague = Accuracy(1.01 * CAMERA.max_sure_sigma_m, 1.0)
    features = camera_features_of(FEWER.inlier_ratio, vague.position_m, "refined")
    assert CAMERA_CONFIDENCE(features) > CAMERA.unsure_confidence
    assert confidence_with(FEWER, vague, "refined") == CAMERA.unsure_confidence
    assert confidence_with(FEWER, vague, "confirmed") > CAMERA.unsure_confidence
    exacter = Accuracy(0.99 * CAMERA.max_sure_sigma_m, 1.0)
    assert confidence_with(FEWER, exacter, "refined") > CAMERA.unsure_confidence


def test_an_answer_by_another_camera_that_may_be_turned_is_never_sure() -> None:
    turned = Accuracy(0.1, 1.01 * CAMERA.max_sure_sigma_deg)
    assert confidence_with(SURE_POSE, turned, "refined") == CAMERA.unsure_confidence
    assert confidence_with(SURE_POSE, turned, "confirmed") > CAMERA.unsure_confidence
