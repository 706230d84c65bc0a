"""What a tracker believes of the fixes it is given: how near, how soon and how often they must be seen."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.engine.query.placed import WORLD, Accuracy, PlacedPose, Support
from app.engine.tracking.fix import Fix
from app.geometry.se3 import Pose
from tests.given_fixes import (
    AT_HOME,
    HOME,
    PLAN,
    Seen,
    assert_lost,
    at,
    doubted,
    fix_at,
    remembered,
)
from tests.tracking import TrackerIn


def test_the_first_fix_is_believed_at_once() -> None:
    tracker = TrackerIn(Seen())
    nothing = at(tracker, 100.0)
    assert (nothing.state, nothing.reason, nothing.placed) == ("initializing", "no_match", None)
    assert nothing.support == Support(3, 7)
    first = at(tracker, 100.1, fix_at(50.0))
    assert (first.state, first.reason) == ("tracking", None)
    assert first.placed is not None
    assert tracker.memory.time_s == 100.1


@pytest.mark.parametrize(
    ("waited_s", "distance_m", "believed"),
    [
        # 0.4 m and 3 m a second, up to 4.4 m.
        (0.0, 0.39, True),
        (0.0, 0.41, False),
        (0.5, 1.89, True),
        (0.5, 1.91, False),
        (9.0, 4.39, True),
        (9.0, 4.41, False),
        # A clock that went back gives no time to walk.
        (-0.5, 0.39, True),
        (-0.5, 0.41, False),
    ],
)
def test_what_can_be_reached_is_believed_at_once(waited_s: float, distance_m: float, believed: bool) -> None:
    for fix in (fix_at(distance_m), fix_at(0.0, -distance_m), fix_at(yaw_deg=180.0, x=distance_m)):
        found = at(TrackerIn(Seen(), AT_HOME), 100.0 + waited_s, fix)
        if believed:
            assert (found.state, found.reason) == ("relocalized", None)
        else:
            assert_lost(found, "ambiguous")
            assert found.support == Support(40, 50)


@pytest.mark.parametrize(
    ("climb_m", "believed"), [(1.19, True), (1.21, False), (-1.19, True), (-1.21, False)]
)
def test_another_storey_is_not_reached(climb_m: float, believed: bool) -> None:
    found = at(TrackerIn(Seen(), AT_HOME), 101.0, fix_at(climb_m=climb_m))
    assert (found.placed is not None) == believed


def test_how_uncertain_the_last_place_is_adds_to_the_reach() -> None:
    assert_lost(at(TrackerIn(Seen(), AT_HOME), 100.0, fix_at(0.9)), "ambiguous")
    unsure = remembered(sigma_m=0.2)
    assert at(TrackerIn(Seen(), unsure), 100.0, fix_at(0.9)).state == "relocalized"
    # So does how uncertain the fix is.
    rough = replace(fix_at(0.9), accuracy=Accuracy(0.2, 0.5))
    assert at(TrackerIn(Seen(), AT_HOME), 100.0, rough).state == "relocalized"


@pytest.mark.parametrize(
    ("after_s", "again", "believed"),
    [
        (0.0, fix_at(20.0), True),
        # The second is 0.4 m and 3 m a second from the first at most ...
        (0.0, fix_at(20.39), True),
        (0.0, fix_at(20.41), False),
        (0.2, fix_at(20.0, 0.99), True),
        (0.2, fix_at(20.0, 1.01), False),
        # ... and turned by 30 degrees and 180 degrees a second.
        (0.0, fix_at(20.0, yaw_deg=29.9), True),
        (0.0, fix_at(20.0, yaw_deg=30.1), False),
        (0.1, fix_at(20.0, yaw_deg=-47.9), True),
        (0.1, fix_at(20.0, yaw_deg=-48.1), False),
        # It comes within five seconds, and after the first.
        (5.0, fix_at(20.0), True),
        (5.01, fix_at(20.0), False),
        (-0.1, fix_at(20.0), False),
    ],
)
def test_out_of_reach_a_second_fix_must_agree_with_the_first(
    after_s: float, again: Fix, believed: bool
) -> None:
    # Long enough after the last place to have walked anywhere.
    found = at(doubted(fix_at(20.0), 112.0), 112.0 + after_s, again)
    if believed:
        assert found.state == "relocalized"
        assert found.placed is again.placed
    else:
        assert_lost(found, "ambiguous")


def test_a_second_fix_that_does_not_agree_waits_for_a_third() -> None:
    tracker = doubted(fix_at(20.0), 112.0)
    assert_lost(at(tracker, 112.1, fix_at(30.0)), "ambiguous")
    assert at(tracker, 112.2, fix_at(30.0)).state == "relocalized"
    # What was doubted before does not count any more.
    assert_lost(at(tracker, 112.3, fix_at(20.0)), "ambiguous")


@pytest.mark.parametrize(
    ("away_s", "fix", "believed"),
    [
        (0.2, fix_at(3.9), True),
        (0.2, fix_at(4.0), True),
        (0.2, fix_at(4.1), False),
        (0.2, fix_at(2.0, climb_m=1.1), True),
        (0.2, fix_at(2.0, climb_m=1.3), False),
        (0.2, fix_at(2.0, climb_m=-1.3), False),
        (9.9, fix_at(4.9), False),
        (10.0, fix_at(4.9), True),
        (10.1, fix_at(climb_m=3.0), True),
        # Whichever way the clock went.
        (-10.1, fix_at(4.9), True),
        (-9.8, fix_at(4.9), False),
    ],
)
def test_far_from_the_last_place_fixes_confirm_each_other_after_a_while_only(
    away_s: float, fix: Fix, believed: bool
) -> None:
    tracker = doubted(fix, 100.0 + away_s - 0.05)
    found = at(tracker, 100.0 + away_s, fix)
    if believed:
        assert found.state == "relocalized"
    else:
        assert_lost(found, "ambiguous")


def test_a_camera_that_can_have_left_its_floor_may_be_anywhere() -> None:
    asked: list[tuple[Pose, float]] = []

    def can_change(pose: Pose, away_s: float) -> bool:
        asked.append((pose, away_s))
        return away_s > 0.5

    source = Seen(fix_at(20.0))
    tracker = TrackerIn(source, AT_HOME, can_change_floor=can_change)
    assert_lost(at(tracker, 100.2), "ambiguous")
    assert_lost(at(tracker, 100.4), "ambiguous")
    assert at(tracker, 100.6).state == "relocalized"
    assert source.asked_any_floor == [False, False, True]
    assert {id(pose) for pose, _ in asked} == {id(HOME)}
    assert {round(away_s, 6) for _, away_s in asked} == {0.2, 0.4, 0.6}
    # The time counts whichever way the clock went.
    tracker = TrackerIn(Seen(fix_at(20.0)), AT_HOME, can_change_floor=can_change)
    at(tracker, 99.3)
    assert at(tracker, 99.4).state == "relocalized"


@pytest.mark.parametrize("last", [None, PlacedPose(HOME, PLAN)], ids=["none", "on a plan"])
def test_a_camera_without_a_last_place_in_the_world_has_left_none(last: PlacedPose | None) -> None:
    source = Seen()
    tracker = TrackerIn(source, remembered(last), can_change_floor=lambda *_: True)
    at(tracker, 100.2)
    assert source.asked_any_floor == [False]


def test_a_fix_in_another_frame_is_believed_when_it_is_seen_twice() -> None:
    tracker = doubted(fix_at(frame_id=PLAN))
    # In the world it is another place.
    assert_lost(at(tracker, 100.2, fix_at(20.0)), "ambiguous")
    assert_lost(at(tracker, 100.25, fix_at(20.0, frame_id=PLAN)), "ambiguous")
    found = at(tracker, 100.3, fix_at(20.0, frame_id=PLAN))
    assert found.state == "relocalized"
    assert found.placed is not None
    assert found.placed.frame_id == PLAN
    assert tracker.memory.frame_id == PLAN
    # Within a plan places are near or far as in the world.
    assert at(tracker, 100.4, fix_at(20.3, frame_id=PLAN)).state == "relocalized"
    assert_lost(at(tracker, 100.5, fix_at(30.0, frame_id=PLAN)), "ambiguous")
    assert_lost(at(tracker, 100.6, fix_at(30.0, frame_id=PLAN)), "ambiguous")


def test_where_no_camera_can_be_no_fix_is_believed() -> None:
    source = Seen(fix_at(0.1), around=fix_at(0.1))
    tracker = TrackerIn(source, AT_HOME, is_inside=lambda pose: bool(pose.translation[0] <= 0.0))
    found = at(tracker, 100.1)
    assert_lost(found, "outside_venue")
    assert found.support == Support(40, 50)
    # A plan has no outside: the world is not known there.
    source.everywhere, source.around = fix_at(0.1, frame_id=PLAN), None
    at(tracker, 100.2)
    assert at(tracker, 100.3).state == "relocalized"


def test_a_doubted_fix_is_not_answered_and_the_last_place_stays() -> None:
    tracker = doubted(fix_at(20.0, frame_id=PLAN), 100.1)
    memory = tracker.memory
    assert (memory.state, memory.time_s, memory.frame_id) == ("lost", 100.0, WORLD)
    assert memory.frame_from_camera is HOME
    assert memory.pending is not None
    assert (memory.pending.frame_id, memory.pending_time_s) == (PLAN, 100.1)
    # What nearly is where the camera was is believed at once again.
    assert at(tracker, 100.2, fix_at(0.1)).state == "relocalized"
    assert tracker.memory.pending is None
