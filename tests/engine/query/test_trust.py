"""Whether a pose can be trusted: by counts and probability, not by shares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.trust import (
    FLOORS,
    SPEAKS_FOR,
    TERMS,
    TRUST,
    TrustModel,
    judge_by_trust,
    refused_outright,
    terms_of,
    trust_of,
)
from app.engine.query.verification import Evidence, Limits

LIMITS = Limits()
# A clear view of an ordinary room.
CLEAR = Evidence(
    matches=260,
    inliers=160,
    coverage=0.5,
    distinct=140,
    distinct_cells=0.48,
    unrepeated=120,
    position_sigma_m=0.01,
    keyframe_distance_m=0.5,
    contradicted=0.05,
)
# A right pose on a carpet and wood: most of what agrees is found elsewhere too, a good part is not.
CARPET = replace(CLEAR, inliers=60, matches=190, coverage=0.3, distinct=27, distinct_cells=0.2, unrepeated=16)
# A corridor that looks like another one.
TWIN = replace(
    CLEAR, inliers=150, matches=230, distinct=25, distinct_cells=0.1, unrepeated=4, contradicted=0.4, rival=40
)


def test_a_clear_view_and_a_room_that_resembles_itself_are_trusted() -> None:
    for evidence in (CLEAR, CARPET):
        assert refused_outright(evidence, evidence.position_sigma_m, LIMITS) is None
        assert judge_by_trust(evidence, LIMITS) is None
    assert trust_of(CLEAR) > 0.98


def test_a_place_that_looks_like_another_is_ambiguous() -> None:
    assert judge_by_trust(TWIN, LIMITS) == "ambiguous"
    assert trust_of(TWIN) < 0.5


def test_little_evidence_of_everything_is_too_little() -> None:
    weak = replace(
        CLEAR, inliers=12, distinct=12, unrepeated=12, matches=300, coverage=0.1, distinct_cells=0.1,
        position_sigma_m=0.14,
    )  # fmt: skip
    assert judge_by_trust(weak, replace(LIMITS, max_risk=0.0)) == "too_few_inliers"


@pytest.mark.parametrize(
    ("changes", "sigma_m", "reason"),
    [
        ({"matches": 11, "inliers": 11}, 0.01, "no_match"),
        ({"inliers": 11}, 0.01, "too_few_inliers"),
        ({"coverage": FLOORS.min_coverage - 0.01}, 0.01, "too_few_inliers"),
        ({}, 0.16, "too_few_inliers"),
        ({"rival": 73}, 0.01, "ambiguous"),
        ({"keyframe_distance_m": 12.5}, 0.01, "outside_venue"),
    ],
    ids=str,
)
def test_what_is_refused_whatever_else_speaks_for_it(
    changes: dict[str, float], sigma_m: float, reason: str
) -> None:
    assert refused_outright(replace(CLEAR, **changes), sigma_m, LIMITS) == reason


def test_no_limits_let_every_pose_pass() -> None:
    worst = Evidence(matches=5, inliers=1, rival=1, contradicted=1.0)
    assert refused_outright(worst, 1e9, Limits.none()) is None
    assert judge_by_trust(worst, Limits.none()) is None
    assert trust_of(Evidence(matches=5)) == 0.0


@pytest.mark.parametrize(
    "better",
    [
        {"inliers": 90},
        {"distinct": 40},
        {"unrepeated": 30},
        {"distinct_cells": 0.28},
        {"coverage": 0.45},
        {"matches": 100},
        {"position_sigma_m": 0.01, "rival": 0},
        {"contradicted": 0.0},
    ],
    ids=str,
)
def test_no_evidence_for_a_pose_lowers_its_probability(better: dict[str, float]) -> None:
    base = replace(CARPET, position_sigma_m=0.05, rival=10, contradicted=0.1)
    assert trust_of(replace(base, **better)) >= trust_of(base)


def test_terms_are_bounded_and_grow_with_their_names() -> None:
    many = replace(CLEAR, inliers=5000, distinct=5000, unrepeated=5000, matches=9000)
    more = replace(CLEAR, inliers=500, distinct=500, unrepeated=500, matches=900)
    assert np.array_equal(terms_of(many)[:5], terms_of(more)[:5])
    assert len(terms_of(CLEAR)) == len(TERMS) == len(SPEAKS_FOR) == len(TRUST.weights) == len(TRUST.typical)
    assert all((w >= 0) == s or w == 0 for w, s in zip(TRUST.weights, SPEAKS_FOR, strict=True))
    # A map whose features were not looked for elsewhere is judged by the views that were matched.
    assert terms_of(replace(CLEAR, unrepeated=None))[2] == terms_of(replace(CLEAR, unrepeated=140))[2]
    assert np.isfinite(terms_of(Evidence())).all()


def test_the_reason_is_what_lacks_most() -> None:
    weights = (1.0,) * 7 + (-10.0, -10.0)
    model = TrustModel(-3.0, weights, tuple(terms_of(CLEAR).tolist()))
    assert model.blames(replace(CLEAR, contradicted=0.9)) == "ambiguous"
    assert model.blames(replace(CLEAR, inliers=14, coverage=0.1)) == "too_few_inliers"
    assert model(CLEAR) > model(replace(CLEAR, rival=80))
