"""When a fix that nothing leads to is believed: seen twice, nearby or after a while."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.placed import Accuracy
from app.engine.tracking.fix import Fix, MapFixes, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.tracked import Tracked
from app.geometry.se3 import Pose
from tests.rendered_maps import localizer_of
from tests.scenes import CAMERA, Room, View, pose_at
from tests.tracking import TrackerIn, pose_of

# The other room is so far along x: out of reach of a prior, and of whoever walks for a few seconds.
APART_M = 8.0
KEYFRAMES = [pose_at(1.8 + 0.05 * i, 1.5, 1.4, -8.0 + 16.0 * i) for i in range(2)]
HERE = pose_at(1.85, 1.45, 1.42, 2.0, 1.0)


def moved(pose: Pose, by_m: float) -> Pose:
    return Pose(pose.rotation, pose.translation + np.array([by_m, 0.0, 0.0]))


def elsewhere(view: View) -> View:
    """Return a view of the other room, where that room is."""
    return replace(view, world_from_camera=moved(view.world_from_camera, APART_M))


@pytest.fixture(scope="module")
def fixes(room: Room, foreign_room: Room) -> MapFixes:
    """Fixes by a map of two rooms that look different."""
    there = [elsewhere(foreign_room.view(pose)) for pose in KEYFRAMES]
    return MapFixes(localizer_of([*(room.view(pose) for pose in KEYFRAMES), *there]))


@pytest.fixture(scope="module")
def there(foreign_room: Room) -> View:
    """What a camera sees in the other room."""
    return elsewhere(foreign_room.view(HERE))


def states(tracker: TrackerIn, view: View, times_s: list[float]) -> list[Tracked]:
    return [tracker.process(TrackingFrame.of(view.rgb, time_s), CAMERA) for time_s in times_s]


def seen_here(
    fixes: MapFixes, room: Room, can_change_floor: Callable[[Pose, float], bool] = lambda *_: False
) -> TrackerIn:
    """Return a tracker that saw the first room at 0 s."""
    tracker = TrackerIn(fixes, can_change_floor=can_change_floor)
    assert states(tracker, room.view(HERE), [0.0])[0].state == "tracking"
    return tracker


def assert_found(tracked: Tracked, view: View) -> None:
    assert tracked.state == "relocalized"
    pose = pose_of(tracked)
    assert pose is not None
    off = pose.translation - view.world_from_camera.translation
    assert np.linalg.norm(off) < 0.03


def test_a_fix_is_compared_with_others_by_what_pictures_of_one_camera_differ_by(
    fixes: MapFixes, room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = room.view(HERE)
    whole, among = Accuracy(0.4, 2.0), Accuracy(0.02, 0.3)
    located = replace(fixes.localizer.localize(view.rgb, CAMERA), accuracy=whole, accuracy_among=among)
    monkeypatch.setattr(fixes.localizer, "localize", lambda *_, **__: located)
    found = fixes.locate(TrackingFrame.of(view.rgb, 0.0), CAMERA, None)
    assert isinstance(found, Fix)
    assert found.accuracy == among
    tracker = TrackerIn(fixes)
    first = states(tracker, view, [0.0])[0]
    assert first.accuracy is not None
    # What is told holds the camera too, and odometry's answers after it.
    assert (first.accuracy.position_m, first.accuracy.orientation_deg) == pytest.approx((0.4, 2.0))
    after = states(tracker, view, [0.1])[0]
    assert (after.method, after.accuracy is not None and after.accuracy.position_m >= 0.4) == (
        "odometry",
        True,
    )


def test_a_camera_of_which_nothing_is_known_is_placed_by_a_sure_fix_alone(
    fixes: MapFixes, room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = room.view(HERE)
    located = fixes.localizer.localize(view.rgb, CAMERA)
    frame, unsure = TrackingFrame.of(view.rgb, 0.0), replace(located, confidence=0.89)
    monkeypatch.setattr(fixes.localizer, "localize", lambda *_, **__: unsure)
    found = fixes.locate(frame, CAMERA, None)
    assert isinstance(found, NoFix)
    assert found.reason == "ambiguous"
    assert isinstance(fixes.locate(frame, CAMERA, None, any_floor=True), NoFix)
    # Where it was a moment ago tells whether it can be there.
    assert isinstance(fixes.locate(frame, CAMERA, HERE), Fix)
    assert isinstance(fixes.locate(frame, CAMERA, HERE, any_floor=True), NoFix)


def test_a_place_out_of_reach_is_not_believed_however_often_it_is_seen(
    fixes: MapFixes, room: Room, there: View
) -> None:
    tracker = seen_here(fixes, room)
    # From one look-alike all frames confirm each other.
    for tracked in states(tracker, there, [1.0, 1.2, 9.9]):
        assert (tracked.state, tracked.reason, tracked.placed) == ("lost", "ambiguous", None)
    # Ten seconds are enough to have walked there.
    assert_found(states(tracker, there, [10.1])[0], there)


def test_a_place_out_of_reach_is_believed_when_the_camera_can_have_left_its_floor(
    fixes: MapFixes, room: Room, there: View
) -> None:
    tracker = seen_here(fixes, room, lambda _, away_s: away_s > 1.1)
    first, second = states(tracker, there, [1.0, 1.2])
    assert (first.state, first.reason) == ("lost", "ambiguous")
    assert_found(second, there)
