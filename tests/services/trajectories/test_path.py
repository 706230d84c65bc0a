"""What a fix corrects of a session's trajectory, and that it is stored with the frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.tracking.memory import pose_from_json, pose_to_json
from app.engine.tracking.own_view import OwnView, SeenAgain
from app.engine.tracking.state import TrackingMemory
from app.engine.tracking.tracked import Tracked
from app.geometry.se3 import Pose, perturbed
from app.services.resources import Resources
from app.services.trajectories.path import OPTIONS, PathSinceFix, moved_points, recent_points
from app.settings import Settings
from app.storage.sessions import SessionPoint, create_session, list_points, record_frame
from app.storage.venues import create_venue
from tests.plans import IN_WORLD
from tests.scenes import pose_at

WAY = [pose_at(0.2 * k, 0.0, 1.5) for k in range(6)]
ACCURACY = Accuracy(0.01, 0.1)


def point(frame: int, pose: Pose | None) -> SessionPoint:
    return SessionPoint(
        frame=frame,
        time_s=float(frame),
        tracking="tracking" if pose is not None else "lost",
        pose=pose_to_json(pose),
        floor=None,
        plan=None,
        position_m=0.01,
    )


def tracked(pose: Pose | None, method: str, by_odometry: Pose | None = None) -> Tracked:
    return Tracked(
        state="lost" if pose is None else "tracking",
        reason="no_match" if pose is None else None,
        placed=None if pose is None else PlacedPose(pose),
        method=method,
        accuracy=None if pose is None else ACCURACY,
        unaided_m=0.0,
        camera=None,
        by_odometry=by_odometry,
    )


def walked(path: PathSinceFix, drift_m: float = 0.05) -> list[tuple[SessionPoint, Pose]]:
    """Walk with an odometry that drifts aside, until a fix says so; return what it corrects."""
    assert path.add(tracked(WAY[0], "rgbd"), point(1, WAY[0])) == []
    for k in range(1, 5):
        pose = perturbed(WAY[k], [0, 0, 0, 0, drift_m * k, 0])
        assert path.add(tracked(pose, "odometry"), point(k + 1, pose)) == []
    aside = perturbed(WAY[5], [0, 0, 0, 0, drift_m * 5, 0])
    return path.add(tracked(WAY[5], "rgbd", aside), point(6, WAY[5]))


def test_a_fix_corrects_the_frames_since_the_one_before() -> None:
    path = PathSinceFix()
    corrected = walked(path)
    assert [point.frame for point, _ in corrected] == [2, 3, 4, 5]
    off_m = [abs(float(pose.translation[1])) for _, pose in corrected]
    assert max(off_m) < 0.05
    # The next fix begins anew.
    assert path.frames == []
    assert path.first is not None


def test_what_is_nearly_right_stays() -> None:
    assert walked(PathSinceFix(), drift_m=0.2 * OPTIONS.min_change_m) == []


def loop_back_to(view: Pose, frame: int, now: Pose, aside: Pose) -> Tracked:
    """Return the answer for a frame that shows again what an earlier one showed."""
    memory = TrackingMemory(last=PlacedPose(view), time_s=float(frame))
    none = np.zeros((0, 3))
    kept = OwnView(
        memory=memory,
        pose=view,
        accuracy=ACCURACY,
        descriptors=np.zeros((0, 32), np.uint8),
        points_in_frame=none,
        sigma_m=np.zeros(0),
    )
    seen = SeenAgain(
        view=kept,
        pose=now,
        relative=ACCURACY,
        support=Support(40, 50),
        points_px=np.zeros((0, 2)),
        points_in_frame=none,
        point_sigma_m=np.zeros(0),
    )
    return replace(tracked(now, "odometry", aside), seen_again=seen)


def test_a_loop_corrects_the_frames_since_the_view_that_is_seen_again() -> None:
    path, aside = PathSinceFix(), perturbed(WAY[1], [0, 0, 0, 0, 0.2, 0])
    path.add(tracked(WAY[0], "rgbd"), point(1, WAY[0]))
    for k in range(1, 5):
        pose = perturbed(WAY[k], [0, 0, 0, 0, 0.05 * (k - 1), 0])
        path.add(tracked(pose, "odometry"), point(k + 1, pose))
    # Back at the second frame's place, 20 cm aside by odometry.
    corrected = path.add(loop_back_to(WAY[1], 2, WAY[1], aside), point(6, WAY[1]))
    assert [point.frame for point, _ in corrected] == [3, 4, 5]
    assert path.frames[-2][1] is corrected[-1][1]
    off_m = [abs(float(pose.translation[1])) for _, pose in corrected]
    assert all(after < before for after, before in zip(off_m, (0.05, 0.1, 0.15), strict=True))
    assert np.allclose(path.frames[0][1].translation, WAY[1].translation)
    # The path since the last fix goes on: the next fix corrects all of it.
    assert [point.frame for point, _ in path.frames] == [2, 3, 4, 5, 6]


def test_a_loop_to_a_path_that_was_given_up_corrects_nothing() -> None:
    path = PathSinceFix()
    path.add(tracked(WAY[0], "rgbd"), point(1, WAY[0]))
    path.add(tracked(None, "rgbd"), point(2, None))
    path.add(tracked(WAY[1], "rgbd"), point(3, WAY[1]))
    path.add(tracked(WAY[2], "odometry"), point(4, WAY[2]))
    assert path.add(loop_back_to(WAY[0], 1, WAY[0], WAY[1]), point(5, WAY[0])) == []


def test_nothing_is_corrected_across_frames_that_were_lost() -> None:
    path = PathSinceFix()
    path.add(tracked(WAY[0], "rgbd"), point(1, WAY[0]))
    path.add(tracked(WAY[1], "odometry"), point(2, WAY[1]))
    path.add(tracked(None, "rgbd"), point(3, None))
    assert path.add(tracked(WAY[5], "rgbd", WAY[2]), point(4, WAY[5])) == []


def test_a_fix_without_odometry_corrects_nothing() -> None:
    path = PathSinceFix()
    path.add(tracked(WAY[0], "rgbd"), point(1, WAY[0]))
    path.add(tracked(WAY[1], "odometry"), point(2, WAY[1]))
    assert path.add(tracked(WAY[5], "rgbd"), point(3, WAY[5])) == []


def test_a_copy_goes_on_by_itself() -> None:
    path = PathSinceFix()
    path.add(tracked(WAY[0], "rgbd"), point(1, WAY[0]))
    other = path.copy()
    other.add(tracked(WAY[1], "odometry"), point(2, WAY[1]))
    assert (len(path.frames), len(other.frames)) == (0, 1)


def test_corrected_points_have_their_floor_and_plan_anew() -> None:
    found = moved_points([(point(2, WAY[0]), WAY[3])], [IN_WORLD], has_plan=True)[0]
    assert (found.frame, found.floor) == (2, "0")
    assert found.plan is not None
    assert found.plan[:2] == pytest.approx([0.6, 0.0])
    assert moved_points([(point(2, WAY[0]), WAY[3])], [IN_WORLD], has_plan=False)[0].plan is None
    newest = point(3, WAY[1])
    assert recent_points([point(1, WAY[0]), point(2, WAY[0])], [found], newest, 2) == [found, newest]


@pytest.fixture
def resources(tmp_path: Path) -> Iterator[Resources]:
    found = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    yield found
    found.close()


def test_corrected_points_are_stored_with_the_frame(resources: Resources) -> None:
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
        session, other = (create_session(connection, "v", None, None, None) for _ in range(2))
        for frame in (1, 2):
            record_frame(connection, session, None, {}, point(frame, WAY[0]), 10)
            record_frame(connection, other, None, {}, point(frame, WAY[0]), 10)
        moved = moved_points([(point(1, WAY[0]), WAY[2]), (point(2, WAY[0]), WAY[3])], [], has_plan=True)
        record_frame(connection, session, None, {}, point(3, WAY[4]), 10, moved)
    with resources.database.read() as connection:
        stored = list_points(connection, session.id, 10)
        untouched = list_points(connection, other.id, 10)
    poses = [pose_from_json(each.pose) for each in stored]
    assert [round(float(pose.translation[0]), 6) for pose in poses if pose] == [0.4, 0.6, 0.8]
    assert [each.time_s for each in stored] == [1.0, 2.0, 3.0]
    assert [each.pose for each in untouched] == [point(1, WAY[0]).pose] * 2
