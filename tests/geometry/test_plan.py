"""The floor plan: fit, position and heading, pixels, and the thesis's way from an anchor to the plan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.alignment import rotation_2d
from app.geometry.plan import (
    PlanTransform,
    fit_plan_from_world,
    ground_projection,
    odometry_on_plan,
    pixels_from_plan,
    plan_from_ground_rotation,
    plan_from_pixels,
    plan_position,
    project_to_ground,
    signed_angle_rad,
    start_on_plan,
)
from app.geometry.se3 import Pose, rotation_from_vector
from app.geometry.triangulation import metric_scale

# Camera axes x right, y down, z forward in a world with z up: looking along world y, held upright.
UPRIGHT_NORTH = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def plan_matrix(yaw_rad=0.0, scale=1.0, shift=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:2, :2] = scale * rotation_2d(yaw_rad)
    matrix[2, 2] = scale
    matrix[:3, 3] = shift
    return matrix


def turned_about_vertical(angle_rad):
    return rotation_from_vector([0, 0, angle_rad])


def angle_between_deg(a, b):
    return abs((a - b + 180) % 360 - 180)


@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("scale", [1.0, 1.04])
def test_fit_gives_back_the_plan(columns, scale):
    rng = np.random.default_rng(0)
    world = rng.normal(size=(6, 3)) * 5
    plan = PlanTransform(plan_matrix(2.2, scale, (4, -3, 0)))
    fit = fit_plan_from_world(world[:, :columns], plan.apply(world)[:, :2])
    np.testing.assert_allclose(fit.matrix, plan.matrix, atol=1e-9)
    assert fit.scale == pytest.approx(scale)
    assert fit.residual_rms_m == pytest.approx(0.0, abs=1e-9)


def test_two_points_are_enough_and_the_scale_can_be_held():
    matrix, rms, residuals = fit_plan_from_world([[0, 0], [2, 0]], [[1, 1], [1, 5]], estimate_scale=False)
    np.testing.assert_allclose(PlanTransform(matrix).yaw_deg, 90.0)
    assert PlanTransform(matrix).scale == pytest.approx(1.0)
    np.testing.assert_allclose(residuals, [1.0, 1.0])
    assert rms == pytest.approx(1.0)


def test_residuals_are_distances_on_the_plan_and_least():
    rng = np.random.default_rng(1)
    world = rng.normal(size=(8, 2)) * 5
    plan = world @ rotation_2d(0.7).T + [1, 2] + rng.normal(size=(8, 2)) * 0.1
    fit = fit_plan_from_world(world, plan)
    mapped = PlanTransform(fit.matrix).apply(np.column_stack([world, np.zeros(8)]))[:, :2]
    np.testing.assert_allclose(np.linalg.norm(mapped - plan, axis=1), fit.residuals_m)
    assert fit.residual_rms_m == pytest.approx(np.sqrt(np.mean(fit.residuals_m**2)))
    for yaw, scale, dx in [
        (0.01, 1, 0),
        (-0.01, 1, 0),
        (0, 1.01, 0),
        (0, 0.99, 0),
        (0, 1, 0.02),
        (0, 1, -0.02),
    ]:
        other = mapped @ (scale * rotation_2d(yaw)).T + [dx, 0]
        assert np.mean(np.sum((other - plan) ** 2, axis=1)) > fit.residual_rms_m**2


def test_a_mirrored_plan_is_not_fitted_by_a_reflection():
    world = np.array([[0, 0], [4, 0], [4, 3], [0, 2.0]])
    fit = fit_plan_from_world(world, world * [1, -1])
    assert np.linalg.det(fit.matrix[:2, :2]) > 0
    assert fit.residual_rms_m > 0.5


@pytest.mark.parametrize(
    ("world", "plan"),
    [
        (np.empty((0, 2)), np.empty((0, 2))),
        ([[1, 1]], [[2, 2]]),
        ([[1, 1], [1, 1]], [[0, 0], [5, 5]]),
        ([[0, 0], [5, 5]], [[1, 1], [1, 1]]),
        ([[1, 1, 0], [1, 1, 3]], [[0, 0], [5, 5]]),
    ],
)
def test_points_in_one_spot_fit_no_plan(world, plan):
    with pytest.raises(DegenerateGeometryError):
        fit_plan_from_world(world, plan)


def test_bad_correspondences_are_named():
    with pytest.raises(InvalidInputError):
        fit_plan_from_world([[0, 0], [1, np.nan]], [[0, 0], [1, 1]])
    with pytest.raises(InvalidInputError):
        fit_plan_from_world([[0, 0], [1, 1], [2, 2]], [[0, 0], [1, 1]])


def test_plan_transform_round_trip_and_properties():
    rng = np.random.default_rng(2)
    plan = PlanTransform(plan_matrix(-1.1, 0.97, (10, 5, -2.5)))
    points = rng.normal(size=(7, 3)) * 4
    np.testing.assert_allclose(plan.apply_inverse(plan.apply(points)), points, atol=1e-12)
    np.testing.assert_allclose(plan.apply(points[0]), plan.apply(points)[0])
    assert plan.scale == pytest.approx(0.97)
    assert plan.yaw_deg == pytest.approx(np.degrees(-1.1))
    np.testing.assert_allclose(plan.rotation.T @ plan.rotation, np.eye(3), atol=1e-12)


def test_rounded_plans_are_taken_and_cleaned():
    plan = PlanTransform(np.round(plan_matrix(0.5), 3))
    np.testing.assert_allclose(plan.rotation.T @ plan.rotation, np.eye(3), atol=1e-12)
    assert plan.yaw_deg == pytest.approx(np.degrees(0.5), abs=0.05)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(3),
        np.full((4, 4), np.nan),
        np.zeros((4, 4)),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.diag([1.0, -1.0, 1.0, 1.0]),
        np.diag([1.0, -1.0, -1.0, 1.0]),
        np.diag([1.0, 1.0, 2.0, 1.0]),
        np.diag([1.0, 1.1, 1.0, 1.0]),
        Pose(rotation_from_vector([0.1, 0, 0]), np.zeros(3)).matrix,
        Pose(UPRIGHT_NORTH, np.zeros(3)).matrix,
    ],
)
def test_what_is_no_plan_transform_is_refused(matrix):
    with pytest.raises(InvalidInputError):
        PlanTransform(matrix)


@pytest.mark.parametrize("turn_deg", [0, 45, 90, 180, 270, 359])
def test_heading_is_the_optical_axis_on_the_plan(turn_deg):
    world_from_camera = Pose(
        turned_about_vertical(np.radians(turn_deg)) @ UPRIGHT_NORTH, np.array([1.0, 2.0, 1.5])
    )
    x, y, heading_deg = plan_position(np.eye(4), world_from_camera)
    assert (x, y) == pytest.approx((1.0, 2.0))
    assert angle_between_deg(heading_deg, 90 + turn_deg) < 1e-9
    turned_plan = PlanTransform(plan_matrix(np.radians(30), 2.0, (5, 5, 0)))
    x, y, heading_deg = plan_position(turned_plan, world_from_camera)
    assert angle_between_deg(heading_deg, 120 + turn_deg) < 1e-9
    np.testing.assert_allclose([x, y], 2 * rotation_2d(np.radians(30)) @ [1, 2] + [5, 5])


@given(st.floats(-89.9999, 89.9999), st.floats(0, 360))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_heading_does_not_depend_on_how_far_the_camera_tilts(tilt_deg, turn_deg):
    # A turn about the camera's own x axis tilts the view up or down, straight up and straight down included.
    tilt = rotation_from_vector([np.radians(tilt_deg), 0, 0])
    pose = Pose(turned_about_vertical(np.radians(turn_deg)) @ UPRIGHT_NORTH @ tilt, np.zeros(3))
    heading_deg = plan_position(np.eye(4), pose).heading_deg
    assert 0 <= heading_deg < 360
    assert angle_between_deg(heading_deg, 90 + turn_deg) < 1e-3


@pytest.mark.parametrize("tilt_deg", [-90, 90])
def test_heading_straight_up_and_down(tilt_deg):
    tilt = rotation_from_vector([np.radians(tilt_deg), 0, 0])
    assert plan_position(np.eye(4), Pose(UPRIGHT_NORTH @ tilt, np.zeros(3))).heading_deg == pytest.approx(
        90.0
    )


def test_plan_pixels_have_v_down_and_round_trip():
    assert pixels_from_plan(0, 0, 0.05, (100, 400)) == (100, 400)
    assert pixels_from_plan(1.0, 2.0, 0.05, (100, 400)) == pytest.approx((120, 360))
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 10))
    back = plan_from_pixels(*pixels_from_plan(x, y, 0.02, (7, 8)), 0.02, (7, 8))
    np.testing.assert_allclose(back, (x, y), atol=1e-12)
    for bad in (0, -0.1, np.nan, np.inf):
        with pytest.raises(InvalidInputError):
            pixels_from_plan(0, 0, bad, (0, 0))
    with pytest.raises(InvalidInputError):
        plan_from_pixels(0, 0, 0.05, (0, np.nan))


@pytest.mark.parametrize("angle_deg", [-179, -90, -30, 0, 30, 90, 179])
def test_angles_have_a_sign(angle_deg):
    start = np.array([2.0, 1.0])
    end = 5 * rotation_2d(np.radians(angle_deg)) @ start
    assert np.degrees(signed_angle_rad(start, end)) == pytest.approx(angle_deg)
    np.testing.assert_allclose(plan_from_ground_rotation(start, end) @ start * 5, end, atol=1e-9)


def test_no_angle_without_length():
    with pytest.raises(DegenerateGeometryError):
        signed_angle_rad([0, 0], [1, 0])
    with pytest.raises(DegenerateGeometryError):
        plan_from_ground_rotation([1, 0], [0, 0])


def test_ground_axes_are_right_and_forward_of_an_upright_camera():
    np.testing.assert_array_equal(ground_projection(), [[1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(ground_projection([0, 9.8, 0]), ground_projection(), atol=1e-12)
    np.testing.assert_array_equal(
        project_to_ground([[1, 2, 3], [4, 5, 6]], ground_projection()), [[1, 3], [4, 6]]
    )
    with pytest.raises(InvalidInputError):
        ground_projection([0, 0, 0])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_with_gravity_ground_lengths_and_angles_are_true_however_the_phone_is_held(seed):
    rng = np.random.default_rng(seed)
    world_from_camera = rotation_from_vector(rng.normal(size=3) * 0.8) @ UPRIGHT_NORTH
    to_ground = ground_projection(world_from_camera.T @ [0, 0, -1])
    vectors_in_world = rng.normal(size=(2, 3))
    ground = project_to_ground(vectors_in_world @ world_from_camera, to_ground)
    np.testing.assert_allclose(
        np.linalg.norm(ground, axis=1), np.linalg.norm(vectors_in_world[:, :2], axis=1)
    )
    seen = signed_angle_rad(ground[0], ground[1])
    true = signed_angle_rad(vectors_in_world[0, :2], vectors_in_world[1, :2])
    assert angle_between_deg(np.degrees(seen), np.degrees(true)) < 1e-6


@pytest.mark.parametrize("roll_deg", [0, 20, -35])
@pytest.mark.parametrize("seed", range(4))
def test_phone_is_found_on_the_plan_by_a_monitoring_camera_and_tracked_on(seed, roll_deg):
    rng = np.random.default_rng(seed)
    plan = PlanTransform(plan_matrix(rng.uniform(-3, 3), 1.0, (*rng.normal(size=2) * 5, 0)))
    roll = rotation_from_vector([0.2, 0, np.radians(roll_deg)])
    world_from_phone = Pose(
        turned_about_vertical(rng.uniform(0, 6)) @ UPRIGHT_NORTH @ roll, rng.normal(size=3) * 4
    )
    tilt = rotation_from_vector([-0.5, 0, 0])
    world_from_anchor = Pose(
        turned_about_vertical(rng.uniform(0, 6)) @ UPRIGHT_NORTH @ tilt, rng.normal(size=3) * 4
    )
    poi_in_anchor = np.array([0.8, -0.3, 4.0])
    poi_in_world = world_from_anchor.apply(poi_in_anchor)

    # What image matching gives: the anchor from the phone, shrunk by an unknown scale.
    anchor_from_phone = world_from_anchor.inverse() @ world_from_phone
    unknown = 3.7
    shrunk = Pose(anchor_from_phone.rotation, anchor_from_phone.translation / unknown)
    distance_m = float(np.linalg.norm(poi_in_anchor))
    scale = metric_scale(distance_m, poi_in_anchor[2] / unknown, poi_in_anchor[:2] / poi_in_anchor[2])
    assert scale == pytest.approx(unknown)

    phone_from_anchor = shrunk.inverse()
    to_ground = ground_projection(world_from_phone.rotation.T @ [0, 0, -1])
    anchor_to_poi = phone_from_anchor.rotation @ (poi_in_anchor / unknown)
    anchor_on_plan = plan.apply(world_from_anchor.translation)[:2]
    plan_from_ground = plan_from_ground_rotation(
        project_to_ground(anchor_to_poi, to_ground), plan.apply(poi_in_world)[:2] - anchor_on_plan
    )
    start = start_on_plan(anchor_on_plan, phone_from_anchor.translation, scale, plan_from_ground, to_ground)
    np.testing.assert_allclose(start, plan.apply(world_from_phone.translation)[:2], atol=1e-9)

    world_from_later = Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3) * 4)
    first_from_later = world_from_phone.inverse() @ world_from_later
    moved = odometry_on_plan(
        start, first_from_later.translation / unknown, scale, plan_from_ground, to_ground
    )
    np.testing.assert_allclose(moved, plan.apply(world_from_later.translation)[:2], atol=1e-9)


def test_anchor_functions_refuse_numbers_that_are_not_finite():
    for function in (start_on_plan, odometry_on_plan):
        with pytest.raises(InvalidInputError):
            function([0, 0], [0, 0, 1], np.nan, np.eye(2), ground_projection())
        with pytest.raises(InvalidInputError):
            function([0, np.inf], [0, 0, 1], 1.0, np.eye(2), ground_projection())
