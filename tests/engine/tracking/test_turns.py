"""Turns that are faster than flow can follow."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.tracking.odometry.turning import shift_between, turned
from app.engine.tracking.settings import TrackerSettings
from app.vision.images import to_gray
from tests.engine.tracking.test_tracker import MapFixes, error_m, fixes, frame_of, run  # noqa: F401
from tests.scenes import CAMERA, Room, pose_at
from tests.tracking import TrackerIn

ODOMETRY_ONLY = TrackerSettings(use_refresh=False, relocalize_every=10**6)


@pytest.mark.parametrize("degrees", [8.0, 15.0, 20.0, -20.0])
def test_a_turn_is_told_by_the_pictures(room: Room, degrees: float) -> None:
    before, after = (room.view(pose_at(2.0, 1.5, 1.4, yaw)) for yaw in (0.0, degrees))
    shift = shift_between(to_gray(before.rgb), to_gray(after.rgb))
    assert shift is not None
    # A turn to the left moves the picture to the right.
    assert shift == pytest.approx([CAMERA.focal_px * np.tan(np.radians(degrees)), 0.0], abs=8.0)
    middle = CAMERA.principal_point_px[None]
    assert turned(middle, CAMERA, shift) == pytest.approx(middle + shift, abs=0.5)


def test_what_hardly_moves_is_left_to_flow(room: Room) -> None:
    here = to_gray(room.view(pose_at(2.0, 1.5, 1.4, 0.0)).rgb)
    assert shift_between(here, to_gray(room.view(pose_at(2.0, 1.5, 1.4, 0.3)).rgb)) is None


@pytest.mark.parametrize("degrees", [20.0, -20.0])
def test_odometry_follows_a_turn_of_twenty_degrees(fixes: MapFixes, room: Room, degrees: float) -> None:  # noqa: F811
    poses = [pose_at(1.8, 1.5, 1.45), *(pose_at(1.8 + 0.03 * i, 1.5, 1.45, degrees) for i in range(1, 4))]
    views = [room.view(pose) for pose in poses]
    results = run(TrackerIn(fixes, settings=ODOMETRY_ONLY), views)
    assert [result.method for result in results] == ["rgbd", *["odometry"] * 3]
    assert max(error_m(result, pose) for result, pose in zip(results, poses, strict=True)) < 0.05


def test_a_video_of_fast_turns_is_tracked(fixes: MapFixes, room: Room) -> None:  # noqa: F811
    poses = [pose_at(1.8 + 0.04 * i, 1.5, 1.45, -40 + 20.0 * i) for i in range(5)]
    views = [room.view(pose) for pose in poses]
    tracker = TrackerIn(fixes)
    results = [tracker.process(frame_of(view, i), CAMERA) for i, view in enumerate(views)]
    assert {result.state for result in results} == {"tracking"}
    assert max(error_m(result, pose) for result, pose in zip(results, poses, strict=True)) < 0.05
