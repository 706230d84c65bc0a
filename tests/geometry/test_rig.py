"""The pose of cameras that move together: exact, with outliers, with unequal cameras; and its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_covariance
from app.geometry.estimators.interface import RansacBudget
from app.geometry.estimators.opencv_estimators import OpenCvEstimators
from app.geometry.reprojection import project_from_world
from app.geometry.rigs.pose import estimate_rig_pose, rig_covariance
from app.geometry.rigs.refinement import refine_rig_pose, refine_with_uncertain_motion
from app.geometry.rigs.view import RigView
from app.geometry.se3 import (
    Pose,
    attitude_difference_rad,
    perturbed,
    position_difference_m,
    rotation_from_vector,
)
from tests.synthetic import CAMERAS, random_pose

LIMIT = 6.0 / 525.0


def rig(
    seed: int,
    cameras: list[Camera],
    *,
    apart_m: float,
    noise_px: float = 0.0,
    wrong: float = 0.0,
    n: int = 80,
) -> tuple[Pose, list[RigView]]:
    rng = np.random.default_rng(seed)
    world_from_rig, views = random_pose(rng), []
    for k, camera in enumerate(cameras):
        turn = rotation_from_vector(0.1 * k * rng.normal(size=3))
        rig_from_camera = Pose(turn, apart_m * k * rng.normal(size=3))
        pixels = rng.uniform([20, 20], [camera.width - 20, camera.height - 20], size=(n, 2))
        points = (world_from_rig @ rig_from_camera).apply(camera.unproject(pixels, rng.uniform(2, 5, size=n)))
        pixels = pixels + noise_px * rng.normal(size=(n, 2))
        is_wrong = rng.random(n) < wrong
        points[is_wrong] += rng.normal(size=(int(is_wrong.sum()), 3))
        views.append(RigView(pixels, points, camera, rig_from_camera))
    return world_from_rig, views


def estimate(views: list[RigView]) -> Pose:
    found = estimate_rig_pose(views, LIMIT, 2000)
    assert found is not None
    return found


def assert_near(found: Pose, truth: Pose, position_m: float, attitude_deg: float) -> None:
    assert position_difference_m(found, truth) < position_m
    assert np.degrees(attitude_difference_rad(found, truth)) < attitude_deg


@pytest.mark.parametrize("apart_m", [0.0, 0.3])
@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV", "OPENCV_FISHEYE"])
def test_exact_points_give_the_exact_pose(model: str, apart_m: float) -> None:
    truth, views = rig(1, [CAMERAS[model]] * 3, apart_m=apart_m)
    assert_near(estimate(views), truth, 1e-4, 1e-3)


@pytest.mark.parametrize("apart_m", [0.0, 0.3])
def test_wrong_matches_are_left_out(apart_m: float) -> None:
    truth, views = rig(2, [CAMERAS["PINHOLE"]] * 3, apart_m=apart_m, noise_px=1.0, wrong=0.7)
    assert_near(estimate(views), truth, 0.03, 0.6)


def test_cameras_of_other_resolutions_are_compared_as_angles() -> None:
    small = CAMERAS["PINHOLE"]
    fx, fy, cx, cy = small.params
    large = Camera("PINHOLE", 4 * 640, 4 * 480, (4 * fx, 4 * fy, 4 * cx + 1.5, 4 * cy + 1.5))
    truth, views = rig(3, [large, small, small], apart_m=0.2, wrong=0.5)
    # The noise is that of one angle: without the scale the large picture's matches are all outliers.
    rng = np.random.default_rng(3)
    noisy = [
        RigView(
            view.points_px + view.camera.focal_px / small.focal_px * rng.normal(size=view.points_px.shape),
            view.points_in_world,
            view.camera,
            view.rig_from_camera,
        )
        for view in views
    ]
    assert_near(estimate(noisy), truth, 0.03, 0.6)
    assert_near(estimate(noisy[::-1]), truth, 0.03, 0.6)


def test_too_few_points_give_none() -> None:
    _, views = rig(4, [CAMERAS["PINHOLE"]] * 2, apart_m=0.1, n=1)
    assert estimate_rig_pose(views, LIMIT, 100) is None


def test_refinement_leads_back_to_the_pose() -> None:
    truth, views = rig(5, [CAMERAS["OPENCV"]] * 3, apart_m=0.3)
    start = perturbed(truth, [0.01, -0.02, 0.01, 0.03, 0.02, -0.04])
    assert_near(refine_rig_pose(views, start), truth, 1e-5, 1e-4)


def test_uncertain_motion_leaves_a_view_that_knows_its_own_pose_where_it_is() -> None:
    truth, views = rig(10, [CAMERAS["PINHOLE"]] * 2, apart_m=0.3, noise_px=0.3, n=300)
    off = Pose(rotation_from_vector([0.0, 0.002, 0.0]), np.array([0.01, 0.0, 0.01]))
    false = [views[0], replace(views[1], rig_from_camera=views[1].rig_from_camera @ off)]
    alone, exact = refine_rig_pose(views[:1], truth), refine_rig_pose(false, truth)
    assert position_difference_m(exact, alone) > 0.003
    allowing = refine_with_uncertain_motion(false, exact, [(0.0, 0.0), (0.02, 0.004)])
    assert position_difference_m(allowing, alone) < 0.3 * position_difference_m(exact, alone)
    # Without uncertainty it is the refinement of all.
    certain = refine_with_uncertain_motion(false, exact, [(0.0, 0.0)] * 2)
    assert_near(certain, exact, 1e-4, 1e-3)


def test_uncertain_motion_places_a_view_that_sees_nothing_by_the_others() -> None:
    truth, views = rig(11, [CAMERAS["PINHOLE"]] * 2, apart_m=0.3, noise_px=0.3, n=300)
    blind = views[0].take(np.zeros(300, dtype=bool))
    found = refine_with_uncertain_motion(
        [blind, views[1]], perturbed(truth, np.full(6, 0.01)), [(0.0, 0.0), (0.02, 0.01)]
    )
    assert_near(found, truth, 0.005, 0.1)


def test_the_covariance_of_one_camera_in_the_rigs_centre_is_that_of_its_pose() -> None:
    truth, views = rig(6, [CAMERAS["OPENCV"]], apart_m=0.0, noise_px=1.0)
    sigma_m = np.full(len(views[0].points_px), 0.01)
    own = pose_covariance(
        views[0].points_px,
        views[0].points_in_world,
        views[0].camera,
        truth,
        point_sigma_m=sigma_m,
        lens_sigma=0.03,
    )
    np.testing.assert_allclose(rig_covariance(views, truth, [sigma_m], lens_sigma=0.03), own, rtol=1e-9)


def test_the_covariance_is_by_the_derivatives_of_the_rigs_pose() -> None:
    truth, views = rig(7, [CAMERAS["PINHOLE"]] * 3, apart_m=0.4)
    exact = rig_covariance(views, truth, [np.zeros(len(view.points_px)) for view in views])
    rows = []
    for view in views:
        steps = np.eye(6) * 1e-6
        plus, minus = (
            [
                project_from_world(
                    view.points_in_world,
                    view.camera,
                    perturbed(truth, sign * step) @ view.rig_from_camera,
                )
                for step in steps
            ]
            for sign in (1, -1)
        )
        rows.append(((np.array(plus) - np.array(minus)) / 2e-6).transpose(1, 2, 0).reshape(-1, 6))
    jacobian = np.concatenate(rows)
    # Exact pixels have the least standard deviation that is assumed.
    expected = 0.2**2 * np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(exact, expected, rtol=1e-4, atol=1e-14)


def test_a_covariance_needs_points_in_view() -> None:
    truth, views = rig(8, [CAMERAS["PINHOLE"]] * 2, apart_m=0.1, n=1)
    with pytest.raises(DegenerateGeometryError, match="four points"):
        rig_covariance(views, truth, [np.zeros(1)] * 2)


@pytest.mark.parametrize("apart_m", [0.0, 0.3])
def test_opencv_finds_the_pose_too(apart_m: float) -> None:
    truth, views = rig(9, [CAMERAS["OPENCV"]] * 3, apart_m=apart_m, noise_px=1.0, wrong=0.5)
    budget = RansacBudget(max_error_px=6.0, max_iterations=2000, min_iterations=100, seed=0)
    found = OpenCvEstimators().rig_pose(views, budget, loss_scale_px=2.0)
    assert found is not None
    assert_near(found, truth, 0.03, 0.6)
