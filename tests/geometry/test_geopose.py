"""GeoPoses: what a camera sees ahead, to the left and above is so on Earth, and angles are those of the standard."""

from __future__ import annotations

import numpy as np
import pytest

from app.geometry.geodesy import enu_from_geodetic
from app.geometry.geopose import CAMERA_FROM_BODY, GeoPose, geopose_of
from app.geometry.se3 import Pose, rotation_from_quaternion, rotation_from_vector
from tests.synthetic import random_pose

ORIGIN = (8.5402, 47.3782, 450.0)
EAST, NORTH, UP = np.eye(3)
# A level camera, by what is to its right, below and ahead.
LOOKS_EAST = np.column_stack([-NORTH, -UP, EAST])
LOOKS_NORTH = np.column_stack([EAST, -UP, NORTH])
LOOKS_DOWN_TOP_NORTH = np.column_stack([EAST, -NORTH, -UP])


def angles(rotation: np.ndarray) -> tuple[float, float, float]:
    return geopose_of(Pose(rotation, np.zeros(3)), ORIGIN).yaw_pitch_roll_deg


def test_the_body_of_a_camera_is_forward_left_up() -> None:
    assert pytest.approx(np.array([0, 0, 1])) == CAMERA_FROM_BODY @ EAST
    assert pytest.approx(np.array([-1, 0, 0])) == CAMERA_FROM_BODY @ NORTH
    assert pytest.approx(np.array([0, -1, 0])) == CAMERA_FROM_BODY @ UP


def test_angles_in_words() -> None:
    assert angles(LOOKS_EAST) == pytest.approx((0, 0, 0), abs=1e-9)
    assert angles(LOOKS_NORTH) == pytest.approx((90, 0, 0), abs=1e-9)
    assert angles(LOOKS_DOWN_TOP_NORTH) == pytest.approx((90, 90, 0), abs=1e-6)
    tilted_down = rotation_from_vector(np.radians(20) * -EAST) @ LOOKS_NORTH
    assert angles(tilted_down) == pytest.approx((90, 20, 0), abs=1e-9)
    right_side_lower = LOOKS_NORTH @ rotation_from_vector([0, 0, np.radians(10)])
    assert angles(right_side_lower) == pytest.approx((90, 0, 10), abs=1e-9)


def test_quaternion_and_angles_are_one_rotation() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        pose = geopose_of(random_pose(rng), ORIGIN)
        yaw, pitch, roll = np.radians(pose.yaw_pitch_roll_deg)
        turned = (
            rotation_from_vector(yaw * UP)
            @ rotation_from_vector(pitch * NORTH)
            @ rotation_from_vector(roll * EAST)
        )
        assert turned == pytest.approx(pose.enu_from_body, abs=1e-9)
        assert rotation_from_quaternion(*pose.quaternion) == pytest.approx(pose.enu_from_body, abs=1e-9)


def test_the_position_is_that_of_the_camera_and_up_is_its_own() -> None:
    far = geopose_of(Pose(LOOKS_EAST, np.array([3000.0, -4000.0, 5.0])), ORIGIN)
    found = enu_from_geodetic([[far.longitude, far.latitude, far.height_m]], ORIGIN)[0]
    assert found == pytest.approx([3000.0, -4000.0, 5.0], abs=1e-6)
    # Five kilometres away the horizon is tilted by 5,000 m / 6,378 km.
    _, pitch, roll = far.yaw_pitch_roll_deg
    assert np.hypot(pitch, roll) == pytest.approx(np.degrees(5000 / 6_378_000), rel=0.01)


def test_straight_up_has_angles() -> None:
    up = GeoPose(0, 0, 0, rotation_from_vector([0, -np.pi / 2, 0]))
    assert up.yaw_pitch_roll_deg == pytest.approx((0, -90, 0), abs=1e-6)
