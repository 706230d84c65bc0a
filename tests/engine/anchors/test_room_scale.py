"""The scale by a room: exact lengths, furniture, what doesn't lie on the plan, and the height of a phone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.anchors.room_scale import OPTIONS, MatchedLengths, is_above_floor, is_held, scale_of_room
from app.engine.floors.collection import read_collection
from app.engine.floors.plan_distances import distances_by_plan
from app.engine.floors.walls import FloorWalls
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from tests.plans import area, collection
from tests.scenes import pose_at

Array = NDArray[np.float64]

CAMERA = Camera("PINHOLE", 640, 480, (500.0, 500.0, 319.5, 239.5))
MONITOR = pose_at(0.4, 2.5, 2.5, 0.0, -20.0)
PHONE = pose_at(3.0, 2.0, 1.5, 20.0)
UNIT = 0.37


def walls() -> FloorWalls:
    """Return a room of 8 m by 5 m."""
    found = FloorWalls.of(
        read_collection(collection(area("room", 0, 0, 8, 5)), "0")[1], lambda points: points
    )
    assert found is not None
    return found


def seen(
    *,
    count: int = 300,
    elsewhere: float = 0.0,
    before_wall_m: float = 0.0,
    phone: Pose = PHONE,
    seed: int = 1,
) -> MatchedLengths:
    """Return what both see, in units of 0.37 m: a share of it lies elsewhere, or a length before the wall."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0, 0], [639, 479], (count, 2))
    lengths = distances_by_plan(pixels, CAMERA, MONITOR, 0.0, walls())
    furniture = np.arange(count) % 2 == 0
    lengths = np.where(furniture, lengths - before_wall_m, lengths) * np.exp(rng.normal(0, 0.02, count))
    anywhere = np.arange(count) < elsewhere * count
    lengths = np.where(anywhere, np.exp(rng.uniform(np.log(0.2), np.log(30), count)), lengths)
    return MatchedLengths(CAMERA, pixels, lengths / UNIT, (MONITOR.inverse() @ phone).translation / UNIT)


def off(found: object) -> float:
    """Return by which share a scale is off."""
    assert found is not None
    return float(abs(found.log_scale - np.log(UNIT)))  # type: ignore[attr-defined]


def test_what_lies_on_floor_and_walls_gives_the_scale() -> None:
    found = scale_of_room(seen(), MONITOR, walls())
    assert off(found) < 0.03
    assert found is not None
    assert OPTIONS.base_log_sigma < found.log_sigma < 0.2


def test_furniture_before_half_of_a_wall_moves_it_by_less_than_its_sigma() -> None:
    found = scale_of_room(seen(before_wall_m=0.3), MONITOR, walls())
    assert found is not None
    assert off(found) < found.log_sigma


@pytest.mark.parametrize(("elsewhere", "is_known"), [(0.3, True), (0.7, False)])
def test_half_of_the_matches_must_lie_there(elsewhere: float, is_known: bool) -> None:
    found = scale_of_room(seen(elsewhere=elsewhere), MONITOR, walls())
    assert (found is not None) == is_known
    if is_known:
        assert off(found) < 0.05


def test_few_matches_say_nothing() -> None:
    assert scale_of_room(seen(count=OPTIONS.min_matches - 1), MONITOR, walls()) is None
    assert scale_of_room(seen(count=OPTIONS.min_matches), MONITOR, walls()) is not None


def test_no_scale_has_a_phone_above_its_camera_at_a_height_at_which_it_is_held() -> None:
    assert scale_of_room(seen(phone=pose_at(1.5, 2.0, 3.2)), MONITOR, walls()) is None


def test_a_scale_that_has_the_phone_on_the_floor_is_not_taken() -> None:
    assert scale_of_room(seen(phone=pose_at(1.5, 2.0, 0.1)), MONITOR, walls()) is None


@pytest.mark.parametrize(("height_m", "is_known"), [(1.5, True), (1.2, True), (0.95, False)])
def test_what_lies_on_one_wall_alone_needs_a_grown_ups_height(height_m: float, is_known: bool) -> None:
    level = Pose(pose_at(0.0, 0.0).rotation, np.array([6.0, 2.5, 2.5]))
    rng = np.random.default_rng(3)
    pixels = rng.uniform([120, 100], [520, 300], (300, 2))
    lengths = distances_by_plan(pixels, CAMERA, level, 0.0, walls()) / UNIT
    phone = (level.inverse() @ pose_at(5.0, 2.0, height_m)).translation / UNIT
    found = scale_of_room(MatchedLengths(CAMERA, pixels, lengths, phone), level, walls())
    assert (found is not None) == is_known
    # With the floor in view as well the same phone may be a child's.
    wide = rng.uniform([0, 0], [639, 479], (300, 2))
    lengths = distances_by_plan(wide, CAMERA, MONITOR, 0.0, walls()) / UNIT
    phone = (MONITOR.inverse() @ pose_at(3.0, 2.0, height_m)).translation / UNIT
    assert off(scale_of_room(MatchedLengths(CAMERA, wide, lengths, phone), MONITOR, walls())) < 0.05


@pytest.mark.parametrize(("height_m", "is_used"), [(1.05, False), (2.45, True), (5.95, False)])
def test_a_camera_that_hangs_above_no_floor_at_zero_says_nothing_of_the_room(
    height_m: float, is_used: bool
) -> None:
    assert is_above_floor(height_m) == is_used


@pytest.mark.parametrize(
    ("height_m", "baseline_m", "is_possible"),
    [(1.5, 2.0, True), (1.0, 2.0, True), (0.4, 2.0, False), (2.6, 2.0, False), (2.6, 20.0, True)],
)
def test_phones_are_held_between_a_childs_and_a_raised_hand(
    height_m: float, baseline_m: float, is_possible: bool
) -> None:
    assert is_held(pose_at(1.0, 1.0, height_m), baseline_m) == is_possible
