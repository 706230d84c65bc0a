"""A phone that comes back to where it was: what its session has seen itself corrects odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.tracking.fix import Fix, NoFix
from app.engine.tracking.frame import TrackingFrame, find_corners
from app.engine.tracking.odometry.points import TrackedPoints
from app.engine.tracking.own_view import OPTIONS, SeenAgain
from app.engine.tracking.own_views import OwnViews
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.state import TrackingMemory
from app.engine.tracking.tracked import Tracked
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, position_difference_m
from app.vision.images import to_gray
from tests.scenes import CAMERA, Room, View, pose_at
from tests.tracking import TrackerIn, pose_of, sigma_m

FPS = 10.0
WELL_KNOWN, WORSE = Accuracy(0.02, 0.5), Accuracy(0.15, 3.0)
START = pose_at(1.5, 1.35, 1.45, -25)


def corners_of(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (n, 2) of a view's corners and the points (n, 3) that they show."""
    pixels = find_corners(to_gray(view.rgb), np.zeros((0, 2)), 250, distance_px=6)
    columns, rows = np.rint(pixels).astype(int).T
    points = CAMERA.unproject(pixels, view.depth_m[rows, columns])
    return pixels, view.world_from_camera.apply(points)


def followed_in(view: View) -> TrackedPoints:
    """Return a view's corners as points that odometry follows."""
    pixels, points = corners_of(view)
    count = len(pixels)
    return TrackedPoints.fixed(
        np.arange(count), pixels, points, np.full(count, 0.005), view.world_from_camera
    )


def memory_of(view: View, path_m: float = 0.6, time_s: float = 3.0) -> TrackingMemory:
    return TrackingMemory(
        state="tracking",
        last=PlacedPose(view.world_from_camera),
        time_s=time_s,
        fix_accuracy=WELL_KNOWN,
        unaided_m=path_m,
    )


def kept(view: View) -> OwnViews:
    """Return what a session has seen that kept this view."""
    views = OwnViews()
    views.keep(to_gray(view.rgb), CAMERA, memory_of(view), WELL_KNOWN, followed_in(view))
    views.since_look = OPTIONS.look_every
    return views


def found(
    views: OwnViews, now: View, off_m: float = 0.2, accuracy: Accuracy = WORSE, path_m: float = 9.0
) -> SeenAgain | None:
    """Return what a frame shows again when odometry has it so far aside after such a path."""
    pose = now.world_from_camera
    near = Pose(pose.rotation, pose.translation + np.array([off_m, 0.0, 0.0]))
    memory = TrackingMemory(unaided_m=path_m)
    return views.find(to_gray(now.rgb), CAMERA, near, memory, accuracy, 0.25 + 3.0 * accuracy.position_m)


def test_a_view_that_is_seen_again_says_where_the_camera_is(room: Room) -> None:
    views = kept(room.view(START))
    now = room.view(pose_at(1.6, 1.3, 1.5, -20))
    seen = found(views, now)
    assert seen is not None
    assert position_difference_m(seen.pose, now.world_from_camera) < 0.02
    # It is as good as the view was, and no better.
    assert WELL_KNOWN.position_m <= seen.accuracy.position_m < 2.0 * WELL_KNOWN.position_m
    assert seen.time_s == 3.0


def test_the_camera_has_the_drift_that_it_had_then(room: Room) -> None:
    seen = found(kept(room.view(START)), room.view(START))
    assert seen is not None
    now = TrackingMemory(unaided_m=9.0, lens=(0.1, 0.02), pending=PlacedPose(START))
    then = seen.memory_at(seen.pose, now, time_s=20.0)
    assert (then.unaided_m, then.time_s, then.lens, then.pending) == (0.6, 20.0, (0.1, 0.02), None)
    assert then.frame_from_camera == seen.pose


def test_what_looks_the_same_elsewhere_is_no_view_of_the_past(room: Room) -> None:
    other = Room(seed=room.seed + 1)
    assert found(kept(room.view(START)), other.view(START)) is None


def test_a_place_that_odometry_cannot_be_off_by_is_not_believed(room: Room) -> None:
    view, accuracy = room.view(START), Accuracy(0.04, 1.0)
    # The picture is the one of the view, half a metre from where odometry surely is.
    assert found(kept(view), view, off_m=0.5, accuracy=accuracy) is None
    assert found(kept(view), view, off_m=0.2, accuracy=accuracy) is not None


@pytest.mark.parametrize("accuracy", [WELL_KNOWN, Accuracy(0.021, 0.5)])
def test_a_view_that_is_no_more_accurate_is_not_looked_at(room: Room, accuracy: Accuracy) -> None:
    views = kept(room.view(START))
    assert found(views, room.view(START), off_m=0.0, accuracy=accuracy) is None
    assert views.since_look > OPTIONS.look_every


def test_a_way_that_does_not_come_back_is_no_loop(room: Room) -> None:
    views = kept(room.view(START))
    # The view was kept after 0.6 m; odometry has the camera 0.2 m away from it.
    least_m = 0.6 + OPTIONS.loop_m + 0.2 * OPTIONS.loop_ratio
    assert found(views, room.view(START), path_m=least_m - 0.01) is None
    assert views.since_look > OPTIONS.look_every
    assert found(views, room.view(START), path_m=least_m + 0.01) is not None


def test_a_view_of_another_direction_is_not_looked_at(room: Room) -> None:
    views = kept(room.view(START))
    assert found(views, room.view(pose_at(1.5, 1.35, 1.45, 60))) is None
    assert views.since_look > OPTIONS.look_every


def test_frames_are_looked_at_now_and_then(room: Room) -> None:
    views = kept(room.view(START))
    assert found(views, room.view(START)) is not None
    looked = [found(views, room.view(START)) is not None for _ in range(OPTIONS.look_every)]
    assert looked == [*[False] * (OPTIONS.look_every - 1), True]


def test_views_are_kept_along_the_path_alone(room: Room) -> None:
    views = OwnViews()

    def keep(x: float, path_m: float) -> int:
        view = room.view(pose_at(x, 1.35, 1.45, -25))
        views.keep(to_gray(view.rgb), CAMERA, memory_of(view, path_m), WELL_KNOWN, followed_in(view))
        return len(views.views)

    # A map that shows itself again before that makes all of this needless.
    assert keep(1.5, path_m=0.5 * OPTIONS.spacing_m) == 0
    assert keep(1.5, path_m=OPTIONS.spacing_m) == 1
    assert keep(1.5 + 0.5 * OPTIONS.spacing_m, path_m=0.8) == 1
    assert keep(1.5 + OPTIONS.spacing_m, path_m=1.0) == 2
    first = views.views[0]
    views.drop_after(first)
    assert views.views == [first]


def test_a_view_without_placed_points_is_not_kept(room: Room) -> None:
    views, view = OwnViews(), room.view(START)
    points = followed_in(view).take(np.arange(OPTIONS.min_points - 1))
    views.keep(to_gray(view.rgb), CAMERA, memory_of(view), WELL_KNOWN, points)
    assert views.views == []


class OneFix:
    """Gives a fix for the first frame, whose view is known, and none after that."""

    def __init__(self, view: View) -> None:
        self.view, self.is_given = view, False

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False
    ) -> Fix | NoFix:
        """Return the fix of the first frame."""
        del frame, near, any_floor
        if self.is_given or camera is None:
            return NoFix("no_match")
        self.is_given = True
        pixels, points = corners_of(self.view)
        return Fix(
            placed=PlacedPose(self.view.world_from_camera),
            accuracy=Accuracy(0.005, 0.1),
            support=Support(len(pixels), len(pixels)),
            confidence=1.0,
            points_px=pixels,
            points_in_frame=points,
            point_sigma_m=np.full(len(pixels), 0.005),
            camera=camera,
        )

    def refresh(self, *_: object) -> Fix | None:
        """Return nothing."""
        return None

    def nearby(self, *_: object) -> Fix | None:
        """Return nothing."""
        return None


@pytest.fixture(scope="module")
def there_and_back(room: Room) -> list[View]:
    """What a phone sees that turns right round a room's corner, and back a little beside its first way."""
    out = [pose_at(1.4 + 0.03 * i, 1.35, 1.45, -25 + 3.0 * i) for i in range(30)]
    back = [pose_at(1.4 + 0.03 * i, 1.38, 1.47, -24 + 3.0 * i) for i in reversed(range(29))]
    return [room.view(pose) for pose in (*out, *back)]


def tracked_along(video: list[View], *, own_views: bool) -> list[Tracked]:
    settings = TrackerSettings(use_own_views=own_views)
    tracker = TrackerIn(OneFix(video[0]), settings=settings)
    return [tracker.process(TrackingFrame.of(view.rgb, i / FPS), CAMERA) for i, view in enumerate(video)]


def test_a_phone_that_comes_back_knows_its_place_better(there_and_back: list[View]) -> None:
    with_views = tracked_along(there_and_back, own_views=True)
    without = tracked_along(there_and_back, own_views=False)
    assert all(answer.placed is not None for answer in (*with_views, *without))
    again = [answer for answer in with_views if answer.seen_again is not None]
    assert again
    assert all(answer.method == "odometry" for answer in with_views[1:])
    assert not any(answer.seen_again for answer in without)

    def off_m(answers: list[Tracked]) -> float:
        pose = pose_of(answers[-1])
        assert pose is not None
        return position_difference_m(pose, there_and_back[-1].world_from_camera)

    assert sigma_m(with_views[-1]) < 0.7 * sigma_m(without[-1])
    assert with_views[-1].unaided_m < 0.7 * without[-1].unaided_m
    assert off_m(with_views) <= 3.0 * sigma_m(with_views[-1])


def test_a_phone_that_was_covered_is_found_by_what_it_has_seen(there_and_back: list[View]) -> None:
    covered = View(START, np.full_like(there_and_back[0].rgb, 40), there_and_back[0].depth_m)
    video = [*there_and_back[:30], covered, covered, *there_and_back[42:]]
    answers = tracked_along(video, own_views=True)
    assert [answer.state for answer in answers[30:32]] == ["lost", "lost"]
    again = next(i for i, answer in enumerate(answers) if answer.state == "relocalized")
    pose = pose_of(answers[again])
    assert pose is not None
    assert position_difference_m(pose, video[again].world_from_camera) < 3.0 * sigma_m(answers[again])
    # It goes on from there, as odometry.
    assert all(answer.state == "tracking" for answer in answers[again + 1 :])
    assert not any(answer.placed for answer in tracked_along(video, own_views=False)[30:])


def test_own_views_do_not_undo_a_doubt(there_and_back: list[View]) -> None:
    covered = View(START, np.full_like(there_and_back[0].rgb, 40), there_and_back[0].depth_m)
    tracker = TrackerIn(OneFix(there_and_back[0]))
    video = [*there_and_back[:30], covered]
    for i, view in enumerate(video):
        tracker.process(TrackingFrame.of(view.rgb, i / FPS), CAMERA)
    known = there_and_back[42]
    time_s = len(video) / FPS
    # A fix elsewhere waits for a second one: where the session was before may be wrong.
    elsewhere = PlacedPose(pose_at(9.0, 9.0))
    tracker.tracker.memory = replace(tracker.memory, pending=elsewhere, pending_time_s=time_s)
    assert tracker.process(TrackingFrame.of(known.rgb, time_s), CAMERA).state == "lost"
    assert tracker.memory.pending == elsewhere
    tracker.tracker.memory = replace(tracker.memory, pending=None)
    assert tracker.process(TrackingFrame.of(known.rgb, time_s + 0.1), CAMERA).state == "relocalized"


def test_a_lost_phone_that_may_be_at_two_places_is_at_none(room: Room) -> None:
    view = room.view(START)
    here = kept(view)
    aside = Pose(START.rotation, START.translation + np.array([0.0, 1.5, 0.0]))
    # A second view with the same picture, 1.5 m aside: another room that is furnished alike.
    twin = View(aside, view.rgb, view.depth_m)
    there = kept(twin)
    gray, within_m = to_gray(view.rgb), 3.0
    assert here.find_lost(gray, CAMERA, START, within_m) is not None
    assert OwnViews([*here.views, *there.views]).find_lost(gray, CAMERA, START, within_m) is None
    assert here.find_lost(gray, CAMERA, aside, within_m=1.0) is None


def test_a_lost_phone_needs_more_that_agrees(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    view, views = room.view(START), kept(room.view(START))
    seen = views.find_lost(to_gray(view.rgb), CAMERA, START, 1.0)
    assert seen is not None
    least = np.ceil((seen.support.inliers + 1) / OPTIONS.min_inliers)
    monkeypatch.setattr("app.engine.tracking.own_views.OPTIONS", replace(OPTIONS, lost_inlier_factor=least))
    assert views.find_lost(to_gray(view.rgb), CAMERA, START, 1.0) is None
    assert found(views, view) is not None
