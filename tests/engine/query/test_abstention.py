"""A wrong answer is worse than none: places that look alike, and evidence that is too thin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.verification import Evidence, Limits, confidence_of, judge
from tests.scenes import View
from tests.server import Server

GOOD = replace(
    Evidence(),
    matches=200,
    inliers=150,
    coverage=0.5,
    distinct=120,
    rival=0,
    keyframe_distance_m=0.5,
    position_sigma_m=0.01,
)
SIGMA_M = 0.02


def test_good_evidence_is_trusted() -> None:
    assert judge(GOOD, SIGMA_M, Limits()) is None
    assert judge(replace(GOOD, unrepeated=60, rival=50, contradicted=0.1), SIGMA_M, Limits()) is None


@pytest.mark.parametrize(
    ("changes", "sigma_m", "reason"),
    [
        ({"matches": 5, "inliers": 5}, SIGMA_M, "no_match"),
        ({"inliers": 10}, SIGMA_M, "too_few_inliers"),
        ({"matches": 5000, "inliers": 60}, SIGMA_M, "too_few_inliers"),
        ({"coverage": 0.02}, SIGMA_M, "too_few_inliers"),
        ({}, 2.0, "too_few_inliers"),
        ({}, float("inf"), "too_few_inliers"),
        ({"rival": 140}, SIGMA_M, "ambiguous"),
        ({"distinct": 10}, SIGMA_M, "ambiguous"),
        ({"distinct": 110, "coverage": 0.16, "position_sigma_m": 1.0}, SIGMA_M, "too_few_inliers"),
        ({"distinct": 90, "coverage": 0.16}, SIGMA_M, "ambiguous"),
        ({"unrepeated": 20}, SIGMA_M, "ambiguous"),
        ({"unrepeated": 40, "rival": 50}, SIGMA_M, "ambiguous"),
        ({"contradicted": 0.4}, SIGMA_M, "ambiguous"),
        ({"keyframe_distance_m": 100.0}, SIGMA_M, "outside_venue"),
    ],
    ids=str,
)
def test_thin_evidence_is_not(changes: dict[str, float], sigma_m: float, reason: str) -> None:
    weak = replace(GOOD, **changes)
    assert judge(weak, sigma_m, Limits()) == reason
    assert judge(weak, sigma_m, Limits.none()) is None


def test_confidence_grows_with_the_evidence() -> None:
    shares = (0.0, 0.1, 0.3, 0.7, 1.0)
    values = [
        confidence_of(replace(GOOD, distinct=round(150 * s), coverage=s, position_sigma_m=0.3 - 0.29 * s))
        for s in shares
    ]
    assert values == sorted(values)
    assert 0 <= values[0] < 0.5 < values[-1] <= 1


def test_a_room_that_is_in_the_map_twice_is_ambiguous(
    museum: Server, scan_zip: bytes, queries: list[View]
) -> None:
    venue = museum.add_venue("twins")
    moved = np.eye(4)
    moved[0, 3] = 30.0
    again = {"mode": "extend", "world_from_scan": moved.tolist(), "force": True}
    museum.add_maps(venue, (scan_zip, {"gravity": [0, 0, -1]}), (scan_zip, again))
    for query in queries:
        result = museum.locate(query.jpeg(), venue=venue)
        assert (result["located"], result["reason"]) == (False, "ambiguous")
    # Told where it is, the camera is located again.
    x, y, z = (float(value) for value in queries[0].world_from_camera.translation)
    prior = f'{{"position": {{"x": {x + 30}, "y": {y}, "z": {z}}}, "radius_m": 5}}'
    result = museum.locate(queries[0].jpeg(), venue=venue, prior=prior)
    assert result["pose"]["position"]["x"] == pytest.approx(x + 30, abs=0.03)
