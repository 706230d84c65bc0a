"""The fit of trust: poses that can be told apart are, also in a room that was left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.engine.query.trust import SPEAKS_FOR
from app.errors import InvalidInputError
from bench.evaluation.pose_errors import QueryOutcome
from bench.rooms.trust_fit import (
    Judged,
    calibration_error,
    evidence_from,
    fit_trust,
    leave_one_out,
    probabilities,
)


def outcome(rng: np.random.Generator, right: bool) -> QueryOutcome:
    """Return a pose that was judged: a right one with much evidence, or a look-alike."""
    inliers = int(rng.integers(20, 200))
    share = rng.uniform(0.4, 1.0) if right else rng.uniform(0.0, 0.3)
    values: dict[str, Any] = {"position_m": float("inf"), "orientation_deg": 180.0, "reason": "ambiguous"}
    return QueryOutcome(
        name="a",
        located=False,
        inliers=inliers,
        confidence=0.0,
        milliseconds=1.0,
        matches=2 * inliers,
        coverage=float(rng.uniform(0.2, 0.6)),
        rival_share=0.0 if right else float(rng.uniform(0.0, 0.4)),
        distinct_share=float(share),
        unrepeated_share=float(share),
        distinct_cells=float(0.5 * share),
        contradicted_share=float(rng.uniform(0.0, 0.2) if right else rng.uniform(0.1, 0.6)),
        position_sigma_m=0.02,
        candidate_m=0.02 if right else 8.0,
        candidate_deg=0.3,
        **values,
    )


def room(seed: int) -> Judged:
    rng = np.random.default_rng(seed)
    return Judged.of([outcome(rng, right) for right in [True] * 80 + [False] * 40])


def test_look_alikes_get_a_low_probability() -> None:
    judged = room(0)
    model = fit_trust(judged)
    probability = probabilities(model, judged)
    assert probability[judged.right].min() > probability[~judged.right].max()
    assert all((w >= 0) if s else (w <= 0) for w, s in zip(model.weights, SPEAKS_FOR, strict=True))


def test_a_room_that_was_left_out_is_judged_as_well() -> None:
    found = leave_one_out({"a": room(1), "b": room(2), "c": room(3)}, 0.3)
    assert [each.room for each in found] == ["a", "b", "c"]
    for each in found:
        assert (each.poses, each.right, each.answered_wrong) == (120, 80, 0)
        assert each.answered_right > 70
        assert each.calibration_error < 0.2


def test_poses_that_are_refused_anyway_are_not_asked_for() -> None:
    rng = np.random.default_rng(4)
    judged = Judged.of(
        [outcome(rng, True), QueryOutcome.from_dict({**outcome(rng, True).as_dict(), "inliers": 5})]
    )
    assert judged.terms.shape == (1, len(SPEAKS_FOR))
    with pytest.raises(InvalidInputError, match="poses that are wrong"):
        fit_trust(judged)


def test_evidence_is_that_of_the_outcome() -> None:
    found = evidence_from(outcome(np.random.default_rng(5), True))
    assert found.inliers * 2 == found.matches
    assert found.unrepeated == found.distinct
    assert found.contradicted < 0.2


def test_calibration_error_is_the_distance_of_probability_and_truth() -> None:
    right = np.array([True] * 75 + [False] * 25)
    assert calibration_error(np.full(100, 0.75), right, 1) == 0.0
    assert calibration_error(np.full(100, 0.95), right, 1) == pytest.approx(0.2)
    assert calibration_error(np.zeros(0), np.zeros(0, bool)) == 0.0
