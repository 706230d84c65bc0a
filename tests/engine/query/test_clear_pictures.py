"""A picture that looks as its pose says all over needs fewer inliers that are not repeated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from app.engine.query.second.agreement import Agreement
from app.engine.query.verification import judge
from tests.engine.query.test_verification import AT_THE_EDGE, EDGE

CLEAR_LIMITS = replace(
    EDGE,
    min_clear_cells=10,
    max_disagreeing_share_of_clear=0.125,
    min_unrepeated_of_clear=8,
    min_unrepeated_share_of_clear=0.125,
    max_similarity_of_clear=0.8,
    min_similarity_elsewhere=1.0,
)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, None),
        ({"agreement": Agreement(agreeing=9, disagreeing=0)}, "ambiguous"),
        ({"agreement": Agreement(agreeing=13, disagreeing=2)}, "ambiguous"),
        ({"agreement": None}, "ambiguous"),
        ({"unrepeated": 7}, "ambiguous"),
        ({"similarity_elsewhere": 0.8}, "ambiguous"),
        # More than what is nowhere else is explained by another place.
        ({"rival": 9}, "ambiguous"),
    ],
    ids=str,
)
def test_a_picture_that_looks_clearly_as_the_pose_says_needs_fewer_unrepeated_inliers(
    changes: dict[str, Any], reason: str | None
) -> None:
    agreement = Agreement(agreeing=14, disagreeing=2)
    evidence = replace(AT_THE_EDGE, unrepeated=8, rival=0, similarity_elsewhere=0.79, agreement=agreement)
    assert judge(replace(evidence, **changes), 0.1, CLEAR_LIMITS) == reason
    assert judge(evidence, 0.1, replace(CLEAR_LIMITS, min_clear_cells=0)) == "ambiguous"
    fewer = replace(CLEAR_LIMITS, min_unrepeated_share_of_clear=0.2)
    assert judge(evidence, 0.1, fewer) == "ambiguous"
