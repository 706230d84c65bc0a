"""What a walker did between two frames: by what is seen of it, else as little as nothing says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.plan_walk.motion import OPTIONS, PlanOdometry
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from tests.scenes import CAMERA as ROOM_CAMERA
from tests.scenes import Room, pose_at

Array = NDArray[np.float64]
CAMERA = Camera("PINHOLE", 320, 240, (250.0, 250.0, 159.5, 119.5))
STEP_S = 0.25


def blank(time_s: float, motion: Pose | None = None) -> TrackingFrame:
    """Return a frame of a wall without any texture."""
    return TrackingFrame.of(np.full((240, 320, 3), 128, np.uint8), time_s, motion=motion)


def test_what_is_not_seen_makes_the_heading_less_sure_with_the_time_and_not_with_its_root() -> None:
    odometry = PlanOdometry()
    odometry.start(blank(0.0), Pose.identity())
    motions = [odometry.motion(blank(STEP_S * k), CAMERA) for k in range(1, 9)]
    assert odometry.unseen_s == pytest.approx(2.0)
    turns = np.sqrt(np.cumsum([motion.turned_sigma_rad**2 for motion in motions]))
    assert turns == pytest.approx(OPTIONS.blind_turn_sigma_rad_s * STEP_S * np.arange(1, 9))
    places = np.sqrt(np.cumsum([motion.moved_sigma_m**2 for motion in motions]))
    assert places == pytest.approx(OPTIONS.blind_sigma_m_s * STEP_S * np.arange(1, 9))


def test_the_phones_own_odometry_is_a_step_that_is_seen() -> None:
    odometry = PlanOdometry()
    odometry.start(blank(0.0), Pose.identity())
    odometry.motion(blank(STEP_S), CAMERA)
    assert odometry.unseen_s > 0.0
    odometry.motion(blank(2 * STEP_S, Pose(np.eye(3), np.array([0.0, 0.0, 0.3]))), CAMERA)
    assert odometry.unseen_s == 0.0


@pytest.mark.parametrize("leap_m", [0.0, 1.2])
def test_a_turn_is_seen_where_the_plan_is_wrong_about_most_distances(room: Room, leap_m: float) -> None:
    before, now = pose_at(1.4, 1.5), pose_at(1.65 + leap_m, 1.52, yaw_deg=9.0)
    odometry, rng = PlanOdometry(), np.random.default_rng(2)

    def expected(pixels: Array, _camera: Camera, _pose: Pose) -> Array:
        return np.asarray(rng.uniform(0.7, 5.0, len(pixels)))

    first = TrackingFrame.of(room.view(before).rgb, 0.0)
    odometry.start(first, before)
    odometry.learn(first, ROOM_CAMERA, expected, None, has_walls=True)
    motion = odometry.motion(TrackingFrame.of(room.view(now).rgb, STEP_S), ROOM_CAMERA)
    if leap_m:
        # Nobody walks 1.5 m in a quarter of a second: whatever fits so is no step.
        assert np.linalg.norm(motion.moved) < OPTIONS.leap_m + OPTIONS.max_speed_m_s * STEP_S
        return
    assert odometry.unseen_s == 0.0
    assert np.degrees(motion.turned_rad) == pytest.approx(9.0, abs=2.5)
    assert motion.turned_sigma_rad < 0.05
