"""The model of confidence, fitted to outcomes whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.verification import Evidence, camera_features_of
from app.errors import InvalidInputError
from bench.evaluation.confidence_fit import fit_camera_confidence, fit_confidence, held_out
from bench.evaluation.pose_errors import QueryOutcome
from bench.evaluation.reliability import POOLED

PLAIN = QueryOutcome(
    name="q",
    located=False,
    position_m=float("inf"),
    orientation_deg=180.0,
    reason=None,
    inliers=40,
    confidence=0.0,
    milliseconds=1.0,
    matches=100,
    rival_share=0.0,
)


def outcomes(count: int = 400, seed: int = 0) -> list[QueryOutcome]:
    """Return poses that are right the more often, the larger the share of distinct matches and the coverage."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        distinct, coverage = rng.uniform(0, 1, 2)
        right = rng.uniform() < 1 / (1 + np.exp(-(8 * distinct + 4 * coverage - 6)))
        found.append(
            replace(
                PLAIN,
                coverage=float(coverage),
                distinct_share=float(distinct),
                position_sigma_m=0.02,
                candidate_m=0.01 if right else 3.0,
                candidate_deg=0.1,
            )
        )
    return found


def test_the_fit_finds_what_the_outcomes_hold() -> None:
    fit = fit_confidence(outcomes())
    assert fit.poses == 400
    assert 0 < fit.right < 400
    weak = Evidence(
        matches=100,
        inliers=40,
        coverage=0.1,
        distinct=4,
        pose_only=40,
        keyframe_distance_m=0.5,
        position_sigma_m=0.02,
    )
    strong = Evidence(
        matches=100,
        inliers=40,
        coverage=0.9,
        distinct=36,
        pose_only=40,
        keyframe_distance_m=0.5,
        position_sigma_m=0.02,
    )
    assert fit.model(weak) < 0.3
    assert fit.model(strong) > 0.9
    assert fit.log_loss < 0.5


@pytest.mark.parametrize("right", [True, False])
def test_one_kind_of_pose_alone_is_no_ground_for_a_fit(right: bool) -> None:
    same = [replace(o, candidate_m=0.01 if right else 9.0) for o in outcomes(20)]
    with pytest.raises(InvalidInputError, match="absent"):
        fit_confidence(same)


def answers(scene_seed: int, count: int = 300) -> list[QueryOutcome]:
    """Return answers by refined cameras that are right the more often, the better their accuracy."""
    rng = np.random.default_rng(scene_seed)
    sigmas = 10 ** rng.uniform(-2, 0, count)
    right = rng.uniform(size=count) < 1 / (1 + np.exp(-(-1.0 - 5.0 * np.log10(sigmas))))
    return [
        replace(
            PLAIN,
            located=True,
            position_m=0.1 if is_right else 2.0,
            orientation_deg=1.0,
            inlier_ratio=0.5,
            coverage=0.8,
            distinct_share=1.0,
            position_sigma_m=0.005,
            inliers=80,
            sigma_m=float(sigma),
            sigma_deg=1.0,
            candidate_m=0.1,
            candidate_deg=1.0,
            confidence=0.5,
            camera_trust="refined",
        )
        for sigma, is_right in zip(sigmas, right, strict=True)
    ]


def test_the_fit_of_cameras_is_as_often_right_as_it_says() -> None:
    fit = fit_camera_confidence(answers(0))
    assert fit.answers == 300
    assert 0 < fit.right < 300
    good, poor = (fit.model(camera_features_of(0.5, sigma_m, "refined")) for sigma_m in (0.015, 0.7))
    assert poor < 0.5 < 0.9 < good
    confidences = [fit.model(camera_features_of(0.5, each.sigma_m or 0.0, "refined")) for each in answers(0)]
    assert np.mean(confidences) == pytest.approx(fit.right / fit.answers, abs=0.01)
    with pytest.raises(InvalidInputError, match="wrong cameras"):
        fit_camera_confidence([answer for answer in answers(0) if answer.right])


def test_a_camera_that_is_confirmed_has_no_part_in_it() -> None:
    confirmed = [replace(answer, camera_trust="confirmed") for answer in answers(1)]
    assert fit_camera_confidence([*answers(0), *confirmed]) == fit_camera_confidence(answers(0))
    assert fit_confidence([*outcomes(), *answers(0)]) == fit_confidence(outcomes())


def test_each_scene_is_measured_with_the_model_of_the_others() -> None:
    scenes = {f"scene{n} default, sift": answers(n) for n in range(3)}
    found = held_out(scenes)
    assert list(found) == ["scene0", "scene1", "scene2", POOLED]
    assert found[POOLED].located == 900
    own = fit_camera_confidence([*answers(1), *answers(2)]).model
    sure = [own(camera_features_of(0.5, answer.sigma_m or 0.0, "refined")) for answer in answers(0)]
    # The model of poses is the service's: it is sure of all of these.
    assert found["scene0"].sure == sum(confidence >= 0.9 for confidence in sure)
