"""The estimators without PoseLib: chosen when it is absent, and as good as those with it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.geometry.estimators.chosen import choose_estimators
from app.geometry.estimators.interface import RansacBudget
from app.geometry.estimators.opencv_estimators import OpenCvEstimators
from app.geometry.estimators.upright_solver import upright_relative_poses
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose, perturbed, position_difference_m, rotation_angle_deg, rotation_from_vector
from app.geometry.triangulation import unit_rays
from tests.synthetic import CAMERAS, MODELS, make_scene, make_two_views, random_pixels

ROOT = Path(__file__).parents[2]
BUDGET = RansacBudget(max_error_px=8.0, max_iterations=5000, min_iterations=100, seed=0)


def absolute_pose(scene, budget=BUDGET, *, points=None, prior=None):
    """Return the `world_from_camera` of a scene by OpenCV, or None."""
    world = scene.points_in_world if points is None else points
    (found,) = OpenCvEstimators().absolute_poses(
        scene.points_px, world, [(scene.camera, budget)], loss_scale_px=2.0, prior=prior
    )
    return None if found is None else found.world_from_camera


def test_opencv_is_chosen_where_poselib_is_absent(monkeypatch):
    monkeypatch.setitem(sys.modules, "poselib", None)
    monkeypatch.delitem(sys.modules, "app.geometry.estimators.poselib_estimators", raising=False)
    assert choose_estimators().name == "OpenCV"


def test_poses_are_found_in_a_process_without_poselib():
    code = (
        "import tests.without_poselib; import numpy as np; from tests.synthetic import make_scene;"
        "from app.geometry.pnp import ESTIMATORS, estimate_pose_lo_ransac as estimate;"
        "scene = make_scene(np.random.default_rng(0), n=300, noise_px=1.0, outlier_ratio=0.5);"
        "found = estimate(scene.points_px, scene.points_in_world, scene.camera);"
        "off = found.world_from_camera.translation - scene.world_from_camera.translation;"
        "print(ESTIMATORS.name, np.linalg.norm(off) < 0.01)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["OpenCV", "True"], done.stderr


@pytest.mark.parametrize("model", MODELS)
def test_opencv_finds_poses_of_every_camera_far_from_the_origin(model):
    scene = make_scene(np.random.default_rng(3), model=model, n=300, noise_px=1.0, outlier_ratio=0.7)
    far = np.array([8000.0, -5000.0, 40.0])
    found = absolute_pose(scene, points=scene.points_in_world + far)
    assert position_difference_m(found, Pose(np.eye(3), far) @ scene.world_from_camera) < 0.02


def test_opencv_uses_a_prior_and_the_order_of_matches_when_samples_are_few():
    few = replace(BUDGET, max_iterations=10)
    scene = make_scene(np.random.default_rng(10), n=300, noise_px=1.0, outlier_ratio=0.85)
    truth = scene.world_from_camera
    prior = perturbed(truth, [0.002, -0.001, 0.002, 0.005, 0.004, -0.005])
    assert position_difference_m(absolute_pose(scene, few, prior=prior), truth) < 0.05
    order = np.argsort(~scene.is_true, kind="stable")
    best_first = replace(
        scene, points_px=scene.points_px[order], points_in_world=scene.points_in_world[order]
    )
    found = absolute_pose(best_first, replace(few, sorted_by_quality=True))
    assert position_difference_m(found, truth) < 0.05


def test_opencv_finds_no_pose_where_there_is_none():
    scene = make_scene(np.random.default_rng(7), n=50)
    one_spot = absolute_pose(scene, points=np.tile(scene.points_in_world[:1], (50, 1)))
    if one_spot is not None:
        errors = reprojection_errors_px(scene.points_px, scene.points_in_world, scene.camera, one_spot)
        assert np.count_nonzero(errors < 8.0) < 10
    behind = perturbed(scene.world_from_camera, [0, np.pi, 0, 0, 0, 0])
    views = make_two_views(np.random.default_rng(1), n=8)
    spot = np.full((8, 2), 200.0)
    assert OpenCvEstimators().relative_pose(spot, spot, (views.camera_a, views.camera_b), BUDGET) is None
    found = absolute_pose(scene, prior=behind)
    assert position_difference_m(found, scene.world_from_camera) < 1e-4


def test_a_sample_of_three_matches_has_the_true_pose_among_its_solutions():
    rng = np.random.default_rng(0)
    for seed in range(20):
        views = make_two_views(np.random.default_rng(seed), n=3)
        turn_rad = float(rng.uniform(-2.5, 2.5))
        b_from_a = Pose(rotation_from_vector([0.0, turn_rad, 0.0]), rng.normal(size=3))
        rays_a, rays_b = unit_rays(views.points_in_a), unit_rays(b_from_a.apply(views.points_in_a))
        turns_rad, directions = upright_relative_poses(rays_a[None], rays_b[None])
        direction = b_from_a.translation / np.linalg.norm(b_from_a.translation)
        errors = np.abs(np.sin(0.5 * (turns_rad - turn_rad))) + 1.0 - np.abs(directions @ direction)
        assert errors.min() < 1e-6


def test_samples_have_the_solutions_of_poselib():
    pytest.importorskip("poselib", reason="PoseLib is not installed")
    from app.geometry.estimators.poselib_estimators import PoseLibEstimators

    rng, found = np.random.default_rng(1), 0
    rays_a, rays_b = unit_rays(rng.normal(size=(60, 3))), unit_rays(rng.normal(size=(60, 3)))
    for a, b in zip(rays_a.reshape(20, 1, 3, 3), rays_b.reshape(20, 1, 3, 3), strict=True):
        ours, theirs = upright_relative_poses(a, b)[0], PoseLibEstimators().upright_relative_poses(a, b)[0]
        # PoseLib leaves out poses with a point behind a camera; the estimator that follows does that here.
        assert all(np.abs(np.sin(0.5 * (ours - each))).min() < 1e-5 for each in theirs)
        found += len(theirs)
    assert found > 20


def views_of_a_wall(rng: np.random.Generator, noise_px: float = 0.3):
    """Return the pixels (n, 2), (n, 2) of matches, most of them on a wall that is seen at a slant, and `b_from_a`."""
    camera = CAMERAS["PINHOLE"]
    a_px = random_pixels(rng, camera, 400)
    rays = camera.unproject(a_px, np.ones(400))
    depths = 3.0 / (rays @ np.array([0.5, 0.1, 1.0]))
    depths[::20] *= rng.uniform(0.7, 0.95, 20)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.3]
    b_from_a = Pose(
        rotation_from_vector(rng.normal(size=3) * 0.05), 0.5 * direction / np.linalg.norm(direction)
    )
    b_px = camera.project(b_from_a.apply(rays * depths[:, None]))
    both = camera.contains(b_px)
    noise = rng.normal(size=(2, int(both.sum()), 2)) * noise_px
    return a_px[both] + noise[0], b_px[both] + noise[1], b_from_a


def test_opencv_takes_the_better_one_of_the_two_poses_that_fit_a_wall():
    camera = CAMERAS["PINHOLE"]
    budget = RansacBudget(max_error_px=2.0, max_iterations=5000, min_iterations=100, seed=0)
    for seed in range(30):
        a_px, b_px, b_from_a = views_of_a_wall(np.random.default_rng(seed))
        found = OpenCvEstimators().relative_pose(a_px, b_px, (camera, camera), budget)
        assert rotation_angle_deg(found.rotation.T @ b_from_a.rotation) < 2.0
        assert found.translation @ b_from_a.translation > 0.9 * 0.5


def test_opencv_finds_relative_poses_as_poselib_does():
    pytest.importorskip("poselib", reason="PoseLib is not installed")
    from app.geometry.estimators.poselib_estimators import PoseLibEstimators

    errors_deg = {}
    for estimators in (OpenCvEstimators(), PoseLibEstimators()):
        turns_deg = []
        for seed in range(20):
            views = make_two_views(np.random.default_rng(seed), n=200, noise_px=0.7, outlier_ratio=0.5)
            budget = RansacBudget(max_error_px=2.0, max_iterations=5000, min_iterations=100, seed=0)
            cameras = views.camera_a, views.camera_b
            found = estimators.relative_pose(views.points_a_px, views.points_b_px, cameras, budget)
            turns_deg.append(rotation_angle_deg(found.rotation.T @ views.b_from_a.rotation))
        errors_deg[estimators.name] = float(np.median(turns_deg))
    assert errors_deg["OpenCV"] < 1.1 * errors_deg["PoseLib"] + 0.01
