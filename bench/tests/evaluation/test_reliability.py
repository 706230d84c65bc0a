"""Confidence against what came true, on outcomes made for it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidInputError
from bench.evaluation.pose_errors import QueryOutcome, summarize
from bench.evaluation.reliability import equal_count_bins, measure_reliability, read_outcomes, with_pool


def outcome(confidence: float, position_m: float = 0.01, orientation_deg: float = 0.5) -> QueryOutcome:
    return QueryOutcome(
        name="q",
        located=True,
        position_m=position_m,
        orientation_deg=orientation_deg,
        reason=None,
        inliers=50,
        confidence=confidence,
        milliseconds=10.0,
    )


def missed() -> QueryOutcome:
    return QueryOutcome(
        name="q",
        located=False,
        position_m=float("inf"),
        orientation_deg=180.0,
        reason="no_match",
        inliers=3,
        confidence=0.0,
        milliseconds=10.0,
    )


WRONG_M = 0.6


def test_confidence_that_comes_true_has_no_error() -> None:
    outcomes = []
    for tenth in range(1, 11):
        right = [outcome(tenth / 10) for _ in range(tenth)]
        outcomes += right + [outcome(tenth / 10, WRONG_M) for _ in range(10 - tenth)]
    found = measure_reliability(outcomes)
    assert found.ece == 0.0
    assert [b.count for b in found.bins] == [10] * 10
    assert (found.sure, found.sure_wrong_percent) == (20, 5.0)


def test_the_error_is_the_gap() -> None:
    outcomes = [outcome(0.95)] * 6 + [outcome(0.95, WRONG_M)] * 2 + [outcome(0.55)] * 2
    # Eight at 0.95, of which 0.75 are right: 0.2 off; two at 0.55, all right: 0.45 off.
    assert measure_reliability(outcomes).ece == pytest.approx(0.8 * 0.2 + 0.2 * 0.45)


def test_five_degrees_off_is_wrong_as_well() -> None:
    assert not outcome(0.9, 0.01, 5.5).right
    assert measure_reliability([outcome(0.9, 0.01, 5.5)]).sure_wrong_percent == 100.0


def test_what_was_not_located_has_no_confidence_but_counts_as_not_covered() -> None:
    found = measure_reliability([outcome(0.99), outcome(0.99), missed(), missed()])
    assert (found.queries, found.located) == (4, 2)
    assert found.ece == pytest.approx(0.01)
    assert (found.coverage, found.risk) == ((0.5,), (0.0,))


def test_nothing_located_is_no_error() -> None:
    found = measure_reliability([missed()])
    assert (found.ece, found.sure_wrong_percent, found.bins, found.coverage) == (None, None, (), ())


def test_the_order_of_equal_confidences_does_not_matter() -> None:
    outcomes = [outcome(0.8)] * 80 + [outcome(0.8, WRONG_M)] * 20
    assert measure_reliability(outcomes).ece == 0.0
    assert measure_reliability(outcomes[::-1]).risk == measure_reliability(outcomes).risk == (0.2,)


def test_bins_hold_all_and_nearly_as_many_each() -> None:
    rng = np.random.default_rng(5)
    confidence = np.sort(rng.uniform(0, 1, 103))
    bins = equal_count_bins(confidence, rng.uniform(0, 1, 103) < confidence)
    assert sum(b.count for b in bins) == 103
    assert {b.count for b in bins} == {10, 11}
    assert [b.confidence for b in bins] == sorted(b.confidence for b in bins)


def test_the_surest_are_answered_first() -> None:
    found = measure_reliability([outcome(0.9), outcome(0.5, WRONG_M), outcome(0.7), missed()])
    assert found.coverage == pytest.approx((0.25, 0.5, 0.75))
    assert found.risk == pytest.approx((0.0, 0.0, 1 / 3))


def test_outcomes_come_back_from_json_with_the_false_fixes(tmp_path: Path) -> None:
    false_fix = QueryOutcome(
        name="wall",
        located=True,
        position_m=float("inf"),
        orientation_deg=180.0,
        reason=None,
        inliers=20,
        confidence=0.7,
        milliseconds=5.0,
    )
    item = {
        "name": "kitchen default",
        "features": "sift",
        "outcomes": [o.as_dict() for o in (outcome(0.9), missed())],
        "absent": {"outcomes": [o.as_dict() for o in (false_fix, missed())]},
    }
    path = tmp_path / "evaluation.json"
    path.write_text(json.dumps([item], allow_nan=False))
    read = read_outcomes(path)
    assert read == {"kitchen default, sift": [outcome(0.9), missed_again(), false_fix]}
    assert measure_reliability(read["kitchen default, sift"]).risk == (0.0, 0.5)


def missed_again() -> QueryOutcome:
    """A query without a pose, as it comes back: both of its errors are infinite."""
    return QueryOutcome(
        name="q",
        located=False,
        position_m=float("inf"),
        orientation_deg=float("inf"),
        reason="no_match",
        inliers=3,
        confidence=0.0,
        milliseconds=10.0,
    )


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '[{"outcomes": []}]', '[{"outcomes": [{"name": "a"}]}]', '[{"outcomes": 3}]', "[1]"],
)
def test_a_file_without_outcomes_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(InvalidInputError):
        read_outcomes(path)


def test_several_groups_are_also_pooled() -> None:
    assert list(with_pool({"a": [outcome(0.9)]})) == ["a"]
    assert len(with_pool({"a": [outcome(0.9)], "b": [missed()]})["all together"]) == 2


def test_the_summary_counts_each_bar() -> None:
    summary = summarize([outcome(0.9, metres) for metres in (0.02, 0.2, 0.3, 0.7, 1.2)] + [missed()] * 5)
    assert summary.within_10cm_5deg_percent == 10.0
    assert summary.within_25cm_percent == 20.0
    assert (summary.gross_percent, summary.over_1m_percent) == (20.0, 10.0)
