"""Where and when a tracker that follows nothing looks for its camera: near its last place, everywhere, or not yet."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.engine.query.placed import Accuracy, PlacedPose
from app.engine.tracking.fix import NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.settings import TrackerSettings
from app.geometry.se3 import Pose
from tests.given_fixes import (
    AT_HOME,
    BLANK,
    HOME,
    NOTHING,
    PLACE,
    PLAN,
    Seen,
    assert_lost,
    at,
    doubted,
    fix_at,
    remembered,
)
from tests.scenes import CAMERA
from tests.tracking import TrackerIn


def test_a_frame_that_shows_nothing_leaves_a_doubted_fix_waiting_for_five_seconds() -> None:
    for after_s, believed in ((4.9, True), (5.1, False)):
        tracker = doubted(fix_at(20.0), 110.0)
        assert_lost(at(tracker, 110.0 + after_s, NOTHING), "no_match")
        assert (tracker.memory.pending is not None) == believed
        # The clock of a phone may be set back: then the fix is still there, or it is not.
        found = at(tracker, 114.0, fix_at(20.0))
        assert (found.state == "relocalized") == believed


def test_near_its_last_place_a_camera_is_found_without_looking_everywhere() -> None:
    source = Seen(around=fix_at(0.3))
    tracker = TrackerIn(source, AT_HOME)
    found = at(tracker, 100.1)
    assert (found.state, source.asked_near) == ("tracking", [])
    assert source.reaches_m == pytest.approx([0.4 + 3.0 * 0.1])
    assert found.fix is source.around
    # Who was lost is told that it is found again.
    assert at(TrackerIn(Seen(around=fix_at(0.3)), remembered(state="lost")), 100.1).state == "relocalized"


def test_what_is_found_near_the_last_place_must_be_in_reach() -> None:
    for around in (fix_at(0.9), fix_at(climb_m=1.3)):
        source = Seen(around=around)
        assert_lost(at(TrackerIn(source, AT_HOME), 100.1), "no_match")
        assert source.asked_near == [HOME]


@pytest.mark.parametrize(
    ("time_s", "last"),
    [(103.1, PLACE), (96.9, PLACE), (100.1, None), (100.1, PlacedPose(HOME, PLAN))],
    ids=["later", "before", "no place", "on a plan"],
)
def test_only_a_place_in_the_world_of_a_moment_ago_is_looked_around(
    time_s: float, last: PlacedPose | None
) -> None:
    source = Seen(around=fix_at())
    at(TrackerIn(source, remembered(last)), time_s)
    assert source.reaches_m == []
    at(TrackerIn(source, AT_HOME), 103.0)
    assert len(source.reaches_m) == 1


def test_a_camera_that_is_not_known_is_looked_for_everywhere() -> None:
    source = Seen(around=fix_at())
    tracker = TrackerIn(source, AT_HOME)
    tracker.process(TrackingFrame.of(BLANK, 100.1), None)
    assert (source.reaches_m, source.asked_near) == ([], [HOME])


def test_for_half_a_minute_the_last_place_tells_look_alikes_apart() -> None:
    for time_s, near in ((130.0, HOME), (130.1, None), (70.0, HOME), (69.9, None)):
        source = Seen()
        at(TrackerIn(source, AT_HOME), time_s)
        assert source.asked_near == [near]
    # The phone's own motion says where it is by now.
    source = Seen()
    step = Pose(np.eye(3), np.array([0.0, 0.0, 0.5]))
    TrackerIn(source, AT_HOME).process(TrackingFrame.of(BLANK, 100.1), CAMERA, step)
    assert source.asked_near[0] is not None
    assert source.asked_near[0].translation == pytest.approx((HOME @ step).translation)


def test_who_is_lost_for_long_is_looked_for_twice_a_second() -> None:
    source = Seen()
    tracker = TrackerIn(source, AT_HOME)
    # In the first two seconds with every frame.
    for time_s in (100.5, 100.6, 101.9, 101.95):
        assert_lost(at(tracker, time_s), "no_match")
    assert len(source.asked_near) == 4
    assert_lost(at(tracker, 102.1, NoFix("poor_image")), "no_match")
    assert len(source.asked_near) == 4
    assert_lost(at(tracker, 102.45), "poor_image")
    # Till the next search its reason holds, and what is seen by then waits.
    assert_lost(at(tracker, 102.85, fix_at(0.1)), "poor_image")
    assert len(source.asked_near) == 5
    assert at(tracker, 102.95).state == "relocalized"


def test_a_fix_that_waits_for_another_is_looked_for_at_once() -> None:
    tracker = doubted(fix_at(20.0), 111.0)
    assert at(tracker, 111.1, fix_at(20.0)).state == "relocalized"


def test_who_was_never_found_is_looked_for_with_every_frame() -> None:
    source = Seen()
    tracker = TrackerIn(source)
    for time_s in (100.0, 100.1, 100.2):
        assert at(tracker, time_s).state == "initializing"
    assert len(source.asked_near) == 3


def test_without_relocation_who_is_lost_stays_lost() -> None:
    source = Seen(fix_at(), around=fix_at())
    settings = TrackerSettings(use_relocation=False)
    tracker = TrackerIn(source, AT_HOME, settings)
    assert_lost(at(tracker, 100.1), "no_match")
    assert (source.asked_near, source.reaches_m) == ([], [])
    # The first fix comes from the map all the same.
    tracker = TrackerIn(source, settings=settings)
    assert at(tracker, 100.1).state == "tracking"


@pytest.mark.parametrize(
    ("drift", "reach_m"),
    [
        ({}, 0.4),
        # Three sigmas: of the last fix, of 4 % of the path, and of 8 % of the turns seen at 1.5 m.
        ({"fix_accuracy": Accuracy(0.1, 0.0)}, 0.4 + 3 * 0.1),
        ({"unaided_m": 5.0}, 0.4 + 3 * 0.2),
        ({"unaided_rad": 2.0}, 0.4 + 3 * 0.24),
        ({"fix_accuracy": Accuracy(0.3, 0.0), "unaided_m": 10.0}, 0.4 + 3 * 0.5),
    ],
    ids=str,
)
def test_a_camera_is_looked_for_as_far_as_it_may_have_drifted(drift: dict[str, Any], reach_m: float) -> None:
    source = Seen()
    at(TrackerIn(source, replace(AT_HOME, **drift)), 100.0)
    assert source.reaches_m == pytest.approx([reach_m])
