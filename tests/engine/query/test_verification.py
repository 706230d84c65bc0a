"""What counts as evidence for a pose, and the limits of it: at each limit a pose passes, beyond it it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.matches import Matches
from app.engine.query.second.agreement import Agreement
from app.engine.query.verification import (
    CONFIDENCE,
    ConfidenceModel,
    Evidence,
    Limits,
    confidence_of,
    coverage,
    evidence_of,
    features_of,
    gather_evidence,
    judge,
)
from tests.scenes import CAMERA

SIZE_PX = (320, 240)
LIMITS = Limits()
# At each limit at once: binary fractions, so that shares are what they are said to be.
EDGE = Limits(
    min_inliers=64,
    min_inlier_ratio=0.25,
    min_coverage=0.5,
    min_distinct_share=0.5,
    min_distinct_coverage=0.25,
    min_unrepeated_share=0.25,
    max_contradicted_share=0.25,
    max_contradicted_share_of_twin=0.25,
    max_rival_share=0.25,
    max_position_sigma_m=0.125,
    max_keyframe_distance_m=8.0,
    min_confidence=0.0,
)
AT_THE_EDGE = Evidence(
    matches=256,
    inliers=64,
    coverage=0.5,
    distinct=32,
    rival=16,
    rival_only=0,
    pose_only=0,
    keyframe_distance_m=8.0,
    position_sigma_m=0.01,
    unrepeated=16,
    contradicted=0.25,
)


def test_at_its_limits_a_pose_is_trusted() -> None:
    assert judge(AT_THE_EDGE, 0.125, EDGE) is None


@pytest.mark.parametrize(
    ("changes", "sigma_m", "reason"),
    [
        ({"matches": 63}, 0.125, "no_match"),
        ({"inliers": 63, "rival": 0}, 0.125, "too_few_inliers"),
        ({"matches": 257}, 0.125, "too_few_inliers"),
        ({"coverage": 0.499}, 0.125, "too_few_inliers"),
        ({}, 0.126, "too_few_inliers"),
        ({"distinct": 31, "coverage": 1.0}, 0.125, "ambiguous"),
        ({"unrepeated": 15, "rival": 0}, 0.125, "ambiguous"),
        ({"contradicted": 0.251}, 0.125, "ambiguous"),
        ({"rival": 17, "unrepeated": 64}, 0.125, "ambiguous"),
        ({"keyframe_distance_m": 8.01}, 0.125, "outside_venue"),
    ],
    ids=str,
)
def test_beyond_any_of_them_it_is_not(changes: dict[str, float], sigma_m: float, reason: str) -> None:
    assert judge(replace(AT_THE_EDGE, **changes), sigma_m, EDGE) == reason


def test_what_is_distinct_must_cover_enough_of_the_picture() -> None:
    limits = replace(EDGE, min_distinct_coverage=0.375)
    # Three quarters of half the picture, or half of three quarters.
    assert judge(replace(AT_THE_EDGE, distinct=48), 0.1, limits) is None
    assert judge(replace(AT_THE_EDGE, coverage=0.75), 0.1, limits) is None
    assert judge(replace(AT_THE_EDGE, distinct=47), 0.1, limits) == "ambiguous"
    assert judge(replace(AT_THE_EDGE, coverage=0.74), 0.1, limits) == "ambiguous"


def test_a_pose_of_less_than_the_least_confidence_is_not_trusted() -> None:
    confidence = confidence_of(AT_THE_EDGE)
    assert judge(AT_THE_EDGE, 0.125, replace(EDGE, min_confidence=confidence)) is None
    sure = replace(EDGE, min_confidence=confidence + 1e-6)
    assert judge(AT_THE_EDGE, 0.125, sure) == "too_few_inliers"


def test_repetition_counts_only_where_it_was_counted() -> None:
    repeated = replace(AT_THE_EDGE, unrepeated=0, rival=0)
    assert judge(repeated, 0.1, EDGE) == "ambiguous"
    assert judge(replace(repeated, unrepeated=None), 0.1, EDGE) is None
    # Limits may leave it out, whatever another place explains.
    free = replace(EDGE, min_unrepeated_share=0.0, max_rival_share=1.0)
    assert judge(replace(AT_THE_EDGE, unrepeated=0, rival=16), 0.1, free) is None


def test_what_another_place_explains_must_not_be_more_than_what_is_nowhere_else() -> None:
    limits = replace(EDGE, max_rival_share=1.0)
    assert judge(replace(AT_THE_EDGE, unrepeated=20, rival=20), 0.1, limits) is None
    assert judge(replace(AT_THE_EDGE, unrepeated=20, rival=21), 0.1, limits) == "ambiguous"


@pytest.mark.parametrize(
    ("agreement", "reason"),
    [
        (None, None),
        (Agreement(agreeing=6, disagreeing=2), None),
        (Agreement(agreeing=5, disagreeing=0), "ambiguous"),
        (Agreement(agreeing=6, disagreeing=3), "ambiguous"),
        (Agreement(), "ambiguous"),
    ],
    ids=str,
)
def test_a_picture_must_look_as_the_pose_says_where_that_was_compared(
    agreement: Agreement | None, reason: str | None
) -> None:
    limits = replace(EDGE, min_agreeing_cells=6, max_disagreeing_share=0.25)
    evidence = replace(AT_THE_EDGE, agreement=agreement)
    assert judge(evidence, 0.125, limits) == reason
    assert judge(evidence, 0.125, EDGE) is None


@pytest.mark.parametrize(
    ("unrepeated", "similarity", "reason"),
    [
        (41, 0.75, "ambiguous"),
        (42, 0.75, None),
        # Nothing elsewhere in the map looks like the matched keyframes.
        (41, 0.74, None),
        # Half of the inliers are on things that only this place has.
        (50, 0.9, None),
    ],
)
def test_where_places_look_alike_enough_must_be_found_at_one_alone(
    unrepeated: int, similarity: float, reason: str | None
) -> None:
    inliers = 100
    evidence = replace(
        CLEAR,
        matches=150,
        inliers=inliers,
        distinct=80,
        rival=0,
        unrepeated=unrepeated,
        similarity_elsewhere=similarity,
    )
    assert judge(evidence, 0.01, LIMITS) == reason
    assert judge(evidence, 0.01, replace(LIMITS, min_unrepeated_of_twin=0)) is None


def test_a_larger_share_makes_up_for_fewer() -> None:
    evidence = replace(CLEAR, matches=60, inliers=40, distinct=35, rival=0, similarity_elsewhere=0.9)
    assert judge(replace(evidence, unrepeated=20), 0.01, LIMITS) is None
    assert judge(replace(evidence, unrepeated=19), 0.01, LIMITS) == "ambiguous"


def test_where_places_look_alike_less_may_contradict() -> None:
    evidence = replace(CLEAR, contradicted=0.16)
    assert judge(evidence, 0.01, LIMITS) is None
    assert judge(replace(evidence, similarity_elsewhere=0.75), 0.01, LIMITS) == "ambiguous"
    assert judge(replace(evidence, similarity_elsewhere=0.75, contradicted=0.15), 0.01, LIMITS) is None


def test_what_rests_on_repeated_things_may_be_contradicted_less() -> None:
    evidence = replace(CLEAR, unrepeated=119, contradicted=0.16)
    assert judge(evidence, 0.01, LIMITS) == "ambiguous"
    assert judge(replace(evidence, contradicted=0.15), 0.01, LIMITS) is None
    assert judge(replace(evidence, unrepeated=120), 0.01, LIMITS) is None
    assert judge(replace(evidence, unrepeated=None), 0.01, LIMITS) is None
    assert judge(evidence, 0.01, replace(LIMITS, max_contradicted_share_of_twin=1.0)) is None
    lax = replace(LIMITS, max_contradicted_share_of_twin=1.0)
    assert judge(replace(evidence, contradicted=0.24), 0.01, lax) == "ambiguous"


# A clear view of a room that is in the map.
CLEAR = Evidence(
    matches=400,
    inliers=240,
    coverage=0.6,
    distinct=200,
    rival=20,
    rival_only=0,
    pose_only=0,
    keyframe_distance_m=1.0,
    position_sigma_m=0.02,
    unrepeated=170,
    contradicted=0.05,
)


@pytest.mark.parametrize(
    ("passes", "fails", "why"),
    [
        ({"inliers": 16, "matches": 30}, {"inliers": 9, "matches": 20}, "too_few_inliers"),
        ({"matches": 2600}, {"matches": 6000}, "too_few_inliers"),
        ({"coverage": 0.18}, {"coverage": 0.1}, "too_few_inliers"),
        ({"distinct": 150}, {"distinct": 110}, "ambiguous"),
        ({"coverage": 0.2, "distinct": 144}, {"coverage": 0.15, "distinct": 140}, "ambiguous"),
        ({"unrepeated": 100}, {"unrepeated": 55}, "ambiguous"),
        ({"contradicted": 0.18}, {"contradicted": 0.3}, "ambiguous"),
        ({"rival": 80}, {"rival": 150}, "ambiguous"),
        ({"sigma_m": 0.12}, {"sigma_m": 0.2}, "too_few_inliers"),
        ({"keyframe_distance_m": 9.0}, {"keyframe_distance_m": 16.0}, "outside_venue"),
    ],
    ids=str,
)
def test_the_limits_in_use_are_between_a_clear_view_and_chance(
    passes: dict[str, float], fails: dict[str, float], why: str
) -> None:
    def reason(changes: dict[str, float]) -> str | None:
        rest = {name: value for name, value in changes.items() if name != "sigma_m"}
        inliers = rest.get("inliers", CLEAR.inliers)
        # What isn't asked about grows and shrinks with the inliers.
        others = {
            name: round(getattr(CLEAR, name) * inliers / CLEAR.inliers)
            for name in ("distinct", "rival", "unrepeated")
        }
        return judge(replace(CLEAR, **{**others, **rest}), changes.get("sigma_m", 0.02), LIMITS)

    assert reason(passes) is None
    assert reason(fails) == why


def test_a_pose_that_is_right_two_times_in_three_is_not_trusted() -> None:
    doubtful = replace(
        CLEAR,
        matches=2400,
        coverage=0.2,
        distinct=144,
        rival=48,
        unrepeated=120,
        position_sigma_m=0.14,
    )
    assert 0.55 < confidence_of(doubtful) < 0.75
    assert judge(doubtful, 0.14, LIMITS) == "too_few_inliers"
    assert judge(doubtful, 0.14, replace(LIMITS, min_confidence=0.5)) is None


def test_no_limits_let_everything_pass() -> None:
    worst = Evidence(
        matches=100,
        inliers=1,
        coverage=0.0,
        distinct=0,
        rival=1,
        rival_only=1,
        pose_only=0,
        keyframe_distance_m=1e9,
        unrepeated=0,
        contradicted=1.0,
    )
    assert judge(worst, 1e9, Limits.none()) is None
    assert judge(Evidence(), float("inf"), Limits.none()) is None


def test_shares_are_of_the_inliers() -> None:
    assert AT_THE_EDGE.inlier_ratio == 0.25
    assert AT_THE_EDGE.distinct_share == 0.5
    assert AT_THE_EDGE.distinct_coverage == 0.25
    assert AT_THE_EDGE.unrepeated_share == 0.25
    assert replace(AT_THE_EDGE, unrepeated=None).unrepeated_share is None
    nothing = Evidence(matches=7)
    assert (nothing.matches, nothing.inliers, nothing.distinct, nothing.coverage) == (7, 0, 0, 0.0)
    assert (nothing.rival, nothing.rival_only, nothing.pose_only) == (0, 0, 0)
    assert nothing.keyframe_distance_m == nothing.position_sigma_m == float("inf")
    assert (nothing.inlier_ratio, nothing.distinct_share, nothing.unrepeated_share) == (0.0, 0.0, None)
    assert replace(nothing, unrepeated=0).unrepeated_share is None
    assert (Evidence().matches, Evidence().inlier_ratio) == (0, 0.0)


def test_features_count_once_however_often_they_were_matched() -> None:
    pixels = np.array([[10.0, 10.0], [10.0, 10.0], [300.0, 200.0]])
    found = gather_evidence(
        matched_rows=np.array([0, 0, 1, 2, 3, 3, 4, 5]),
        inlier_rows=np.array([0, 0, 1]),
        inlier_px=pixels,
        distinct_rows=np.array([0, 0, 1]),
        rival_rows=np.array([1, 2, 2, 3]),
        size_px=SIZE_PX,
        keyframe_distance_m=1.5,
    )
    assert (found.matches, found.inliers, found.distinct) == (6, 2, 2)
    # The rival has 2 and 3 for itself, the pose 0.
    assert (found.rival, found.rival_only, found.pose_only) == (3, 2, 1)
    assert (found.coverage, found.keyframe_distance_m) == (2 / 48, 1.5)
    assert (found.unrepeated, found.contradicted) == (None, 0.0)


def matches_of(rows: list[int], distinct: list[bool]) -> Matches:
    """Return matches of features of a picture, all in one pixel."""
    count = len(rows)
    return Matches(
        points_px=np.full((count, 2), 10.0),
        points_in_world=np.zeros((count, 3)),
        sigma_m=np.full(count, 0.01),
        query_rows=np.array(rows, np.intp),
        keyframes=np.arange(count),
        distances=np.zeros(count, np.float32),
        distinct=np.array(distinct),
    )


def test_evidence_is_of_what_agrees_and_of_what_agrees_with_a_rival() -> None:
    matches = matches_of([0, 1, 2, 3, 3], [True] * 5)
    inliers = matches_of([0, 1, 1], [False, True, True])
    alone = evidence_of(matches, inliers, CAMERA, 2.0)
    assert (alone.matches, alone.inliers, alone.distinct, alone.rival) == (4, 2, 1, 0)
    assert (alone.coverage, alone.keyframe_distance_m, alone.pose_only) == (1 / 48, 2.0, 2)
    contested = evidence_of(matches, inliers, CAMERA, 2.0, matches_of([1, 2, 3], [True] * 3))
    assert (contested.rival, contested.rival_only, contested.pose_only) == (3, 2, 1)


def test_a_pose_without_inliers_is_judged_like_any_other() -> None:
    assert judge(Evidence(unrepeated=0), 0.01, LIMITS) == "no_match"
    assert judge(Evidence(matches=100, unrepeated=0), 0.01, LIMITS) == "too_few_inliers"


def test_coverage_is_the_share_of_an_8_by_6_grid() -> None:
    cells = np.array([(x, y) for x in range(8) for y in range(6)], float)
    centres = (cells + 0.5) * 40.0
    assert coverage(centres, SIZE_PX) == 1.0
    assert coverage(centres[:12], SIZE_PX) == 0.25
    assert coverage(np.zeros((0, 2)), SIZE_PX) == 0.0
    # A cell has its left and upper border; what is just outside of the picture counts as its border.
    assert coverage(np.array([[39.9, 0.0], [40.0, 0.0]]), SIZE_PX) == 2 / 48
    assert coverage(np.array([[-0.4, -0.4], [0.0, 0.0]]), SIZE_PX) == 1 / 48
    assert coverage(np.array([[320.4, 240.4], [319.0, 239.0]]), SIZE_PX) == 1 / 48
    # Two cells that are neighbours in a column of the grid are not one.
    assert coverage(np.array([[10.0, 230.0], [50.0, 10.0]]), SIZE_PX) == 2 / 48


def test_confidence_is_a_logistic_model_of_five_features() -> None:
    assert features_of(AT_THE_EDGE) == pytest.approx([0.25, 0.5, 2.0, 0.5, 0.25])
    model = ConfidenceModel(-1.0, (1.0, 2.0, 0.5, -1.0, 4.0))
    assert model(AT_THE_EDGE) == pytest.approx(1 / (1 + np.exp(-(-1 + 0.25 + 1.0 + 1.0 - 0.5 + 1.0))))
    # The position counts from 3 mm to 1 m.
    for sigma_m, feature in ((0.001, -np.log10(0.003)), (5.0, 0.0), (float("inf"), 0.0)):
        assert features_of(replace(AT_THE_EDGE, position_sigma_m=sigma_m))[2] == pytest.approx(feature)
    assert features_of(Evidence())[4] == 0.0
    assert confidence_of(Evidence(matches=50)) == 0.0
    assert confidence_of(AT_THE_EDGE) == CONFIDENCE(AT_THE_EDGE)


@pytest.mark.parametrize(
    ("changes", "confidence"),
    [
        ({}, 0.98),
        ({"matches": 240, "rival": 0}, 0.99),
        ({"matches": 4800, "coverage": 0.15, "distinct": 240, "rival": 0, "position_sigma_m": 1.0}, 0.81),
        ({"coverage": 0.15, "distinct": 130, "position_sigma_m": 0.3}, 0.60),
    ],
    ids=str,
)
def test_confidence_of_typical_evidence(changes: dict[str, float], confidence: float) -> None:
    # By `roomfix fit-confidence`; another fit gives others.
    assert confidence_of(replace(CLEAR, **changes)) == pytest.approx(confidence, abs=0.02)


@pytest.mark.parametrize(
    "better",
    [
        {"matches": 128},
        {"coverage": 0.75},
        {"position_sigma_m": 0.005},
        {"distinct": 48},
        {"rival": 4},
    ],
    ids=str,
)
def test_better_evidence_gives_more_confidence(better: dict[str, float]) -> None:
    assert confidence_of(replace(AT_THE_EDGE, **better)) > confidence_of(AT_THE_EDGE)


def test_confidence_of_clear_and_of_poor_evidence() -> None:
    clear = replace(AT_THE_EDGE, matches=80, coverage=0.6, distinct=56, rival=2)
    assert confidence_of(clear) > 0.98
    poor = replace(AT_THE_EDGE, matches=640, coverage=0.15, distinct=24, rival=40, position_sigma_m=0.15)
    assert confidence_of(poor) < 0.3
