"""From which side the points were seen that speak for a pose."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.query.hypothesis import seen_from_one_side

CENTRE = np.array([1.0, 2.0, -0.5])
POINT = CENTRE[None] + [0.0, 0.0, 2.0]


def around(degrees: float, distance_m: float = 2.0) -> np.ndarray:
    """Return a place at a distance from the point, so many degrees around it."""
    angle = np.radians(degrees)
    return POINT[0] + distance_m * np.array([np.sin(angle), 0.0, -np.cos(angle)])


@pytest.mark.parametrize("distance_m", [0.5, 2.0, 7.0])
def test_one_side_ends_eighty_degrees_around_a_point(distance_m: float) -> None:
    sides = {
        angle: seen_from_one_side(POINT, around(angle, distance_m), CENTRE)[0] for angle in range(0, 181, 10)
    }
    assert [angle for angle, same in sides.items() if same] == [0, 10, 20, 30, 40, 50, 60, 70, 80]
    assert not seen_from_one_side(POINT, around(81.0, distance_m), CENTRE)[0]
    assert seen_from_one_side(POINT, around(25.0), CENTRE, min_cosine=0.9)[0]
    assert not seen_from_one_side(POINT, around(26.0), CENTRE, min_cosine=0.9)[0]


def test_each_point_has_its_own_keyframe_or_all_have_one() -> None:
    points = np.repeat(POINT, 3, axis=0)
    centres = np.stack([around(0), around(100), around(60)])
    assert seen_from_one_side(points, centres, CENTRE).tolist() == [True, False, True]
    assert seen_from_one_side(points, centres[1], CENTRE).tolist() == [False] * 3
