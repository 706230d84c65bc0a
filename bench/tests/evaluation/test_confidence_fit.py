"""The model of confidence, fitted to outcomes whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.verification import Evidence
from app.errors import InvalidInputError
from bench.evaluation.confidence_fit import fit_confidence
from bench.evaluation.pose_errors import QueryOutcome

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
