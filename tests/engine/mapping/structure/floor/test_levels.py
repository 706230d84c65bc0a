"""The floor below a walk is found, and how far a path that bends leads away from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.structure.floor.levels import (
    OPTIONS,
    Floor,
    find_floor,
    is_better,
    is_steady,
)
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.se3 import Pose, rotation_from_vector
from tests.engine.mapping.structure.floor.corridor_walk import DOWN, HEIGHT_M, Corridor


def found(part: Reconstruction, down: tuple[float, float, float] = DOWN) -> Floor:
    floor = find_floor(part, down)
    assert floor is not None
    return floor


def test_a_level_floor_is_found_with_its_height_and_its_points() -> None:
    corridor = Corridor()
    part = corridor.slid(1.0)
    floor = found(part)
    assert floor.height == pytest.approx(HEIGHT_M, rel=0.01)
    assert floor.level == pytest.approx(0.0, abs=0.01)
    assert np.abs(part.points[floor.points, 2]).max() < 2 * OPTIONS.layer * HEIGHT_M
    assert np.mean(part.points[floor.points, 2] == 0.0) > 0.85
    assert floor.unevenness < 0.01
    assert is_steady(floor)


@pytest.mark.parametrize("off_deg", [0.0, 2.0])
def test_the_floor_itself_says_which_way_is_up(off_deg: float) -> None:
    turn = rotation_from_vector([np.radians(off_deg), np.radians(off_deg) / 2, 0])
    down = tuple((turn @ np.array(DOWN)).tolist())
    floor = found(Corridor().slid(1.0), down)
    assert np.degrees(np.arccos(floor.up[2])) < 0.1
    assert floor.unevenness < 0.01


def test_a_path_whose_scale_slides_leaves_its_floor() -> None:
    # The floor behind the door rises, which turns the plane through both halves.
    floor = found(Corridor().slid(1.1))
    assert floor.unevenness > 0.02
    assert floor.unsteadiness == pytest.approx(0.1, abs=0.03)
    assert not is_steady(floor)


def test_the_units_of_a_path_say_nothing() -> None:
    part = Corridor().slid(1.05)
    poses = {row: Pose(pose.rotation, 7 * pose.translation) for row, pose in part.poses.items()}
    other = found(replace(part, poses=poses, points=7 * part.points))
    assert other.height == pytest.approx(7 * found(part).height, rel=0.02)
    np.testing.assert_allclose(other.above, found(part).above, atol=0.01)


def test_walls_are_no_floor() -> None:
    assert find_floor(Corridor(floor_share=0.0).slid(1.0), DOWN) is None


def test_a_table_is_no_floor() -> None:
    """What is seen below a layer in all stretches shows that the floor is lower."""
    part = Corridor().slid(1.0)
    rng = np.random.default_rng(0)
    lower = rng.uniform(size=len(part.points)) < 0.4
    points = part.points - lower[:, None] * np.array([0.0, 0.0, 1.0]) * rng.uniform(0.3, 1.0, (len(lower), 1))
    assert find_floor(replace(part, points=points), DOWN) is None


def test_a_floor_that_few_stretches_show_is_none() -> None:
    part = Corridor().slid(1.0)
    on_floor = part.points[:, 2] < 0.05
    far = on_floor & (part.points[:, 0] > 8.0)
    seen = part.observations[~far[part.observations[:, 2]]]
    assert find_floor(replace(part, observations=seen), DOWN) is None


def test_a_path_on_a_level_floor_is_better_than_one_that_is_not() -> None:
    level = found(Corridor().slid(1.0))
    slid = found(Corridor().slid(1.06))
    assert is_better(level, slid)
    assert not is_better(slid, level)
    assert is_better(slid, found(Corridor().slid(1.1)))
    assert not is_better(None, level)
    assert not is_better(replace(level, above=np.array([0.0, 0.2])), slid)
