"""Alignments, the average of poses, gravity, and the point nearest to lines."""

import numpy as np
import pytest

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.alignment import (
    align_2d,
    align_points,
    average_poses,
    fit_affine_2d,
    rotation_2d,
    world_from_scan_by_gravity,
)
from app.geometry.lines import (
    distances_to_lines,
    line_through,
    point_least_squares_to_lines,
    point_nearest_to_lines,
)
from app.geometry.se3 import attitude_difference_rad, perturbed, position_difference_m, rotation_angle_deg
from tests.synthetic import random_pose


@pytest.mark.parametrize("scale", [0.3, 1.0, 4.0])
def test_alignment_gives_back_pose_and_scale(scale):
    rng = np.random.default_rng(0)
    target_from_source, points = random_pose(rng), rng.normal(size=(20, 3))
    moved = target_from_source.apply(scale * points)
    found = align_points(points, moved, with_scale=True)
    np.testing.assert_allclose(found.target_from_source.matrix, target_from_source.matrix, atol=1e-9)
    assert found.scale == pytest.approx(scale)
    assert found.residual_rms_m == pytest.approx(0.0, abs=1e-9)


def test_rigid_alignment_of_noisy_points_is_a_least():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(30, 3))
    target = random_pose(rng).apply(points) + rng.normal(size=(30, 3)) * 0.05
    found = align_points(points, target)
    assert found.scale == 1.0

    def rms(pose):
        return np.sqrt(np.mean(np.sum((pose.apply(points) - target) ** 2, axis=1)))

    assert rms(found.target_from_source) == pytest.approx(found.residual_rms_m)
    for _ in range(20):
        nearby = perturbed(found.target_from_source, rng.normal(size=6) * 0.01)
        assert rms(nearby) > found.residual_rms_m


def test_a_mirror_image_is_never_the_answer():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(10, 3))
    found = align_points(points, points * [1, 1, -1])
    assert np.linalg.det(found.target_from_source.rotation) == pytest.approx(1.0)
    assert found.residual_rms_m > 0.1
    flat = points[:, :2]
    linear, _ = align_2d(flat, flat * [1, -1])
    assert np.linalg.det(linear) > 0


def test_alignment_of_a_plane_of_points_is_enough_and_of_a_line_not():
    rng = np.random.default_rng(3)
    pose, flat = random_pose(rng), rng.normal(size=(6, 3)) * [1, 1, 0]
    np.testing.assert_allclose(
        align_points(flat, pose.apply(flat)).target_from_source.matrix, pose.matrix, atol=1e-9
    )
    line = np.linspace(0, 1, 6)[:, None] * [1.0, 2.0, 3.0]
    for bad in (line, np.ones((6, 3)), flat[:2]):
        with pytest.raises(DegenerateGeometryError):
            align_points(bad, bad)
    with pytest.raises(InvalidInputError):
        align_points(flat, np.full((6, 3), np.nan))


@pytest.mark.parametrize("with_scale", [True, False])
def test_turn_and_scale_on_the_plane(with_scale):
    rng = np.random.default_rng(4)
    points, scale = rng.normal(size=(2, 2)), 2.5 if with_scale else 1.0
    expected = scale * rotation_2d(-2.0)
    linear, shift = align_2d(points, points @ expected.T + [3, -4], with_scale=with_scale)
    np.testing.assert_allclose(linear, expected, atol=1e-12)
    np.testing.assert_allclose(shift, [3, -4], atol=1e-12)


def test_affine_map_on_the_plane():
    rng = np.random.default_rng(5)
    expected, points = np.array([[1.0, 0.4], [-0.2, 2.0]]), rng.normal(size=(8, 2))
    linear, shift = fit_affine_2d(points, points @ expected.T + [1, 2])
    np.testing.assert_allclose(linear, expected, atol=1e-12)
    np.testing.assert_allclose(shift, [1, 2], atol=1e-12)
    with pytest.raises(DegenerateGeometryError):
        fit_affine_2d(np.linspace(0, 1, 5)[:, None] * [1.0, 1.0], points[:5])


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.ones((1, 2)), np.ones((5, 2))])
def test_plane_alignments_refuse_one_spot(points):
    with pytest.raises(DegenerateGeometryError):
        align_2d(points, points)
    with pytest.raises(DegenerateGeometryError):
        fit_affine_2d(points, points)


def test_robust_average_ignores_a_minority_that_is_wrong():
    rng = np.random.default_rng(6)
    truth = random_pose(rng)
    poses = [perturbed(truth, rng.normal(size=6) * 0.01) for _ in range(7)]
    wrong = [perturbed(truth, [1.0, 0.5, -1.0, 5.0, 5.0, 0.0]) for _ in range(3)]
    robust, plain = average_poses(poses + wrong), average_poses(poses + wrong, robust=False)
    assert position_difference_m(robust, truth) < 0.03
    assert attitude_difference_rad(robust, truth) < 0.03
    assert position_difference_m(plain, truth) > 1.0
    clean = average_poses(poses, robust=False)
    assert position_difference_m(clean, truth) < 0.02


@pytest.mark.parametrize("robust", [True, False])
def test_average_moves_with_the_world_and_obeys_weights(robust):
    rng = np.random.default_rng(7)
    poses, elsewhere_from_world = [random_pose(rng) for _ in range(3)], random_pose(rng)
    moved = average_poses([elsewhere_from_world @ pose for pose in poses], robust=robust)
    expected = elsewhere_from_world @ average_poses(poses, robust=robust)
    np.testing.assert_allclose(moved.matrix, expected.matrix, atol=1e-6)
    only_second = average_poses(poses, [0, 1, 0], robust=robust)
    np.testing.assert_allclose(only_second.matrix, poses[1].matrix, atol=1e-6)
    np.testing.assert_allclose(average_poses(poses[:1], robust=robust).matrix, poses[0].matrix, atol=1e-9)


def test_average_refuses_nothing_and_bad_weights():
    with pytest.raises(DegenerateGeometryError):
        average_poses([])
    poses = [random_pose(np.random.default_rng(8))] * 2
    for weights in ([0, 0], [-1, 2], [1], [np.nan, 1]):
        with pytest.raises(InvalidInputError):
            average_poses(poses, weights)


@pytest.mark.parametrize("gravity", [[0, 9.81, 0], [0, 0, -1], [0, 0, 1], [3.0, -1.0, 0.2], [1e-3, 0, 0]])
def test_gravity_puts_z_up_and_turns_no_more_than_needed(gravity):
    world_from_scan = world_from_scan_by_gravity(gravity)
    down = world_from_scan.rotation @ gravity / np.linalg.norm(gravity)
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-9)
    np.testing.assert_array_equal(world_from_scan.translation, np.zeros(3))
    tilt_deg = np.degrees(np.arccos(np.clip(-np.asarray(gravity)[2] / np.linalg.norm(gravity), -1, 1)))
    assert rotation_angle_deg(world_from_scan.rotation) == pytest.approx(tilt_deg, abs=1e-4)


@pytest.mark.parametrize("gravity", [[0, 0, 0], [np.nan, 0, 1], [0, 1], [[0, 0, 1]]])
def test_gravity_without_direction_is_refused(gravity):
    with pytest.raises(InvalidInputError):
        world_from_scan_by_gravity(gravity)


def test_line_through_two_points_contains_them():
    rng = np.random.default_rng(9)
    for p, q in rng.normal(size=(10, 2, 2)):
        line = line_through(p, q)
        assert np.hypot(line[0], line[1]) == pytest.approx(1.0)
        for t in (0.0, 0.5, 3.0):
            assert distances_to_lines(p + t * (q - p), [line])[0] == pytest.approx(0.0, abs=1e-12)
    assert distances_to_lines([5.0, 1.0], [[0.0, 2.0, -6.0]])[0] == pytest.approx(2.0)
    with pytest.raises(DegenerateGeometryError):
        line_through([1.0, 2.0], [1.0, 2.0])


@pytest.mark.parametrize("solve", [point_nearest_to_lines, point_least_squares_to_lines])
def test_lines_through_one_point_meet_there(solve):
    rng = np.random.default_rng(10)
    user = np.array([7.0, 1.0])
    lines = [line_through(user, keyframe) for keyframe in rng.normal(size=(4, 2)) * 5]
    np.testing.assert_allclose(solve(lines), user, atol=1e-9)
    # The length of a line's coefficients doesn't count.
    np.testing.assert_allclose(solve(np.asarray(lines) * [[1], [7], [-2], [0.1]]), user, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_point_has_the_least_sum_of_distances(seed):
    rng = np.random.default_rng(seed)
    lines = rng.normal(size=(4, 3))
    point = point_nearest_to_lines(lines)
    least = distances_to_lines(point, lines).sum()
    offsets = rng.normal(size=(2000, 2)) * rng.choice([1e-3, 0.1, 1.0, 5.0], (2000, 1))
    assert least <= min(distances_to_lines(point + offset, lines).sum() for offset in offsets) + 1e-12


def test_one_wrong_line_in_four_is_outvoted_by_least_sum_but_not_by_least_squares():
    user = np.array([2.0, 3.0])
    lines = [line_through(user, user + d) for d in ([1.0, 0.2], [0.2, 1.0], [1.0, -1.0])]
    lines.append(line_through([12.0, 0.0], [10.0, 9.0]))
    assert np.linalg.norm(point_nearest_to_lines(lines) - user) < 1e-9
    assert np.linalg.norm(point_least_squares_to_lines(lines) - user) > 1.0
    heavy = point_nearest_to_lines(lines, weights=[1, 0.1, 0.1, 5])
    assert distances_to_lines(heavy, lines[3:])[0] == pytest.approx(0.0, abs=1e-9)


def test_among_points_that_are_equally_near_the_middle_is_taken():
    square = [[1.0, 0, 0], [1, 0, -4], [0, 1, 0], [0, 1, -2]]
    np.testing.assert_allclose(point_nearest_to_lines(square), [2.0, 1.0])


@pytest.mark.parametrize("solve", [point_nearest_to_lines, point_least_squares_to_lines])
@pytest.mark.parametrize(
    "lines", [np.empty((0, 3)), [[1.0, 0, 0]], [[1.0, 0, 0], [2.0, 0, 5]], [[0.0, 0, 1], [1, 0, 0]]]
)
def test_lines_that_do_not_cross_are_refused(lines, solve):
    with pytest.raises(DegenerateGeometryError):
        solve(lines)
