"""Rotations and poses: group laws, conversions, and what the constructor refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.errors import InvalidPoseError
from app.geometry.se3 import (
    Pose,
    attitude_difference_rad,
    position_difference_m,
    project_to_so3,
    quaternion_from_rotation,
    rotation_angle_deg,
    rotation_between,
    rotation_from_quaternion,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)
from tests.synthetic import random_pose, random_rotation

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_pose_and_inverse_chain_to_the_identity(seed):
    pose = random_pose(np.random.default_rng(seed))
    np.testing.assert_allclose((pose @ pose.inverse()).matrix, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_chain_is_matrix_product_and_moves_points_alike(seed):
    rng = np.random.default_rng(seed)
    a_from_b, b_from_c = random_pose(rng), random_pose(rng)
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose((a_from_b @ b_from_c).matrix, a_from_b.matrix @ b_from_c.matrix, atol=1e-12)
    np.testing.assert_allclose(
        (a_from_b @ b_from_c).apply(points), a_from_b.apply(b_from_c.apply(points)), atol=1e-11
    )


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_quaternion_and_vector_round_trips(seed):
    rotation = random_rotation(np.random.default_rng(seed))
    quaternion = quaternion_from_rotation(rotation)
    assert quaternion[3] >= 0
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_from_quaternion(*quaternion), rotation, atol=1e-12)
    np.testing.assert_allclose(rotation_from_vector(vector_from_rotation(rotation)), rotation, atol=1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-13, 1e-9, 1e-4, 1.0, np.pi - 1e-9, np.pi])
def test_rotation_vector_at_the_ends_of_its_range(angle_rad):
    vector = angle_rad * np.array([2.0, -1.0, 2.0]) / 3.0
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(np.linalg.norm(vector_from_rotation(rotation)), angle_rad, atol=1e-8)
    np.testing.assert_allclose(rotation_from_vector(vector_from_rotation(rotation)), rotation, atol=1e-8)


def test_quaternion_of_a_quarter_turn_about_z():
    rotation = rotation_from_quaternion(0, 0, np.sqrt(0.5), np.sqrt(0.5))
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_quaternion_length_does_not_matter_but_zero_is_refused():
    np.testing.assert_allclose(
        rotation_from_quaternion(0, 0, 3, 3), rotation_from_quaternion(0, 0, 1, 1), atol=1e-15
    )
    with pytest.raises(InvalidPoseError):
        rotation_from_quaternion(0, 0, 0, 0)
    with pytest.raises(InvalidPoseError):
        rotation_from_quaternion(0, 0, np.nan, 1)


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_rotation_between_is_the_smallest_that_does_it(seed):
    a, b = np.random.default_rng(seed).normal(size=(2, 3))
    rotation = rotation_between(a, b)
    turned = rotation @ a / np.linalg.norm(a)
    np.testing.assert_allclose(turned, b / np.linalg.norm(b), atol=1e-9)
    angle_deg = np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))
    assert rotation_angle_deg(rotation) == pytest.approx(angle_deg, abs=1e-5)


def test_rotation_between_opposite_directions_is_half_a_turn():
    for axis in np.eye(3):
        rotation = rotation_between(axis, -2 * axis)
        np.testing.assert_allclose(rotation @ axis, -axis, atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)


def test_projection_to_so3_leaves_rotations_and_repairs_reflections():
    rotation = random_rotation(np.random.default_rng(1))
    np.testing.assert_allclose(project_to_so3(2.5 * rotation), rotation, atol=1e-12)
    assert np.linalg.det(project_to_so3(rotation @ np.diag([1, 1, -1]))) == pytest.approx(1.0)


def test_pose_from_quaternion_and_matrix_agree():
    pose = Pose.from_quaternion([1, 2, 3], [0.1, 0.2, 0.3, 0.9])
    again = Pose.from_matrix(pose.matrix)
    np.testing.assert_allclose(again.matrix, pose.matrix, atol=1e-14)
    np.testing.assert_allclose(
        Pose.from_quaternion(pose.translation, pose.quaternion).matrix, pose.matrix, atol=1e-12
    )


def test_pose_is_frozen_down_to_its_arrays():
    pose = Pose.identity()
    with pytest.raises(ValueError, match="read-only"):
        pose.translation[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose.rotation[0, 0] = 2.0


def test_pose_takes_rounded_rotations_and_refuses_the_rest():
    rounded = np.round(random_rotation(np.random.default_rng(2)), 3)
    pose = Pose(rounded, np.zeros(3))
    np.testing.assert_allclose(pose.rotation.T @ pose.rotation, np.eye(3), atol=1e-12)
    bad = [
        (np.eye(3) * 1.2, np.zeros(3)),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3)),
        (np.full((3, 3), np.nan), np.zeros(3)),
        (np.eye(3), np.array([0, np.inf, 0])),
        (np.eye(4), np.zeros(3)),
        (np.eye(3), np.zeros(2)),
    ]
    for rotation, translation in bad:
        with pytest.raises(InvalidPoseError):
            Pose(rotation, translation)
    with pytest.raises(InvalidPoseError):
        Pose.from_matrix(np.eye(3))
    with pytest.raises(InvalidPoseError):
        Pose.from_matrix(np.diag([1.0, 1.0, 1.0, 2.0]))


def test_differences_of_two_poses():
    a = Pose.identity()
    b = Pose(rotation_from_vector([0, 0, 0.3]), np.array([3.0, 4.0, 0.0]))
    assert position_difference_m(a, b) == pytest.approx(5.0)
    assert attitude_difference_rad(a, b) == pytest.approx(0.3)
    assert attitude_difference_rad(b, b) == pytest.approx(0.0, abs=1e-12)
