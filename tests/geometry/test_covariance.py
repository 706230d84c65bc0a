"""The Jacobian against finite differences and the covariance against repeated noise."""

from dataclasses import replace

import numpy as np
import pytest

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.covariance import pose_accuracy, pose_covariance, sigma_px_from_residuals
from app.geometry.pose_refinement import refine_pose
from app.geometry.reprojection import project_from_world, reprojection_jacobian
from app.geometry.se3 import Pose, perturbed, vector_from_rotation
from tests.synthetic import MODELS, make_scene


@pytest.mark.parametrize("model", MODELS)
def test_reprojection_jacobian_against_finite_differences(model):
    scene = make_scene(np.random.default_rng(0), model=model, n=40)
    points, camera, pose = scene.points_in_world, scene.camera, scene.world_from_camera
    _, by_pose, by_point = reprojection_jacobian(points, camera, pose)
    step = 1e-6
    for axis in range(6):
        offset = step * np.eye(6)[axis]
        ahead, back = (project_from_world(points, camera, perturbed(pose, sign * offset)) for sign in (1, -1))
        np.testing.assert_allclose(by_pose[:, :, axis], (ahead - back) / (2 * step), rtol=1e-5, atol=2e-3)
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        ahead, back = (project_from_world(points + sign * offset, camera, pose) for sign in (1, -1))
        np.testing.assert_allclose(by_point[:, :, axis], (ahead - back) / (2 * step), rtol=1e-5, atol=2e-3)


def errors_of_refits(scene, rng, sigma_px, sigma_m, count):
    """Return the perturbations (count, 6) from the true pose to the least-squares poses of noisy copies."""
    out = []
    for _ in range(count):
        pixels = scene.points_px + rng.normal(size=scene.points_px.shape) * sigma_px
        points = scene.points_in_world + rng.normal(size=scene.points_in_world.shape) * sigma_m
        pose = refine_pose(pixels, points, scene.camera, scene.world_from_camera, loss="trivial")
        turn = vector_from_rotation(pose.rotation @ scene.world_from_camera.rotation.T)
        out.append(np.concatenate([turn, pose.translation - scene.world_from_camera.translation]))
    return np.array(out)


@pytest.mark.parametrize(("sigma_px", "sigma_m"), [(1.0, 0.0), (0.5, 0.01)])
@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV_FISHEYE"])
def test_covariance_is_the_spread_of_repeated_estimates(model, sigma_px, sigma_m):
    rng = np.random.default_rng(1)
    scene = make_scene(rng, model=model, n=50)
    predicted = pose_covariance(
        scene.points_px,
        scene.points_in_world,
        scene.camera,
        scene.world_from_camera,
        sigma_px,
        point_sigma_m=sigma_m,
    )
    errors = errors_of_refits(scene, rng, sigma_px, sigma_m, 400)
    # Errors measured in predicted standard deviations are standard normal: their square lengths average six.
    lengths = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(predicted), errors)
    assert lengths.mean() == pytest.approx(6.0, rel=0.15)
    np.testing.assert_allclose(errors.std(axis=0), np.sqrt(np.diag(predicted)), rtol=0.2)
    position_m, orientation_deg = pose_accuracy(predicted)
    assert np.sqrt(np.mean(np.sum(errors[:, 3:] ** 2, axis=1))) == pytest.approx(position_m, rel=0.15)
    turned_deg = np.degrees(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1))))
    assert turned_deg == pytest.approx(orientation_deg, rel=0.15)


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_a_principal_point_that_is_not_known_moves_the_pose_by_what_its_error_does(model):
    scene = make_scene(np.random.default_rng(5), model=model, n=400)
    fx, fy, cx, cy, *lens = scene.camera.params
    moved = []
    for du, dv in ((1.0, 0.0), (0.0, 1.0)):
        camera = replace(scene.camera, params=(fx, fy, cx + du, cy + dv, *lens))
        pose = refine_pose(
            scene.points_px, scene.points_in_world, camera, scene.world_from_camera, loss="trivial"
        )
        turn = vector_from_rotation(pose.rotation @ scene.world_from_camera.rotation.T)
        moved.append(np.concatenate([turn, pose.translation - scene.world_from_camera.translation]))
    arguments = scene.points_px, scene.points_in_world, scene.camera, scene.world_from_camera, 1.0
    added = pose_covariance(*arguments, centre_sigma_px=3.0) - pose_covariance(*arguments)
    expected = 9.0 * sum(np.outer(each, each) for each in moved)
    np.testing.assert_allclose(added, expected, atol=0.03 * np.abs(np.diag(expected)).max())
    # However well a fitted focal length is known, the principal point is not.
    fitted = pose_covariance(*arguments, focal_sigma=np.inf, centre_sigma_px=3.0)
    assert pose_accuracy(fitted)[1] > pose_accuracy(added)[1]


def test_covariance_is_symmetric_positive_and_grows_with_noise_squared():
    scene = make_scene(np.random.default_rng(2), n=30)
    arguments = scene.points_px, scene.points_in_world, scene.camera, scene.world_from_camera
    one, three = pose_covariance(*arguments, 1.0), pose_covariance(*arguments, 3.0)
    np.testing.assert_allclose(one, one.T)
    assert np.linalg.eigvalsh(one).min() > 0
    np.testing.assert_allclose(three, 9 * one, rtol=1e-9)


def test_noise_is_estimated_from_the_residuals_and_outliers_hardly_move_it():
    scene = make_scene(np.random.default_rng(3), n=400, noise_px=1.3)
    pose = refine_pose(scene.points_px, scene.points_in_world, scene.camera, scene.world_from_camera)
    arguments = scene.points_in_world, scene.camera, pose
    known = pose_accuracy(pose_covariance(scene.points_px, *arguments, 1.3))[0]
    assert pose_accuracy(pose_covariance(scene.points_px, *arguments))[0] == pytest.approx(known, rel=0.15)
    spoiled = scene.points_px.copy()
    spoiled[:20] += 30.0
    assert pose_accuracy(pose_covariance(spoiled, *arguments))[0] == pytest.approx(known, rel=0.25)


def test_point_noise_is_not_counted_twice():
    rng = np.random.default_rng(4)
    # At nearly one depth, so that the median of the points' noise stands for all.
    scene = make_scene(rng, n=400, noise_px=0.5, planar=True)
    points = scene.points_in_world + rng.normal(size=(400, 3)) * 0.01
    arguments = scene.points_px, points, scene.camera, scene.world_from_camera
    estimated = pose_accuracy(pose_covariance(*arguments, point_sigma_m=np.full(400, 0.01)))
    known = pose_accuracy(pose_covariance(*arguments, 0.5, point_sigma_m=0.01))
    assert estimated[0] == pytest.approx(known[0], rel=0.15)


def test_an_exact_fit_is_never_certain():
    assert sigma_px_from_residuals(np.zeros((4, 2))) == pytest.approx(0.2)


def test_a_fit_of_few_points_makes_its_residuals_small():
    rng = np.random.default_rng(6)
    found = []
    for _ in range(200):
        scene = make_scene(rng, n=4, noise_px=1.0)
        arguments = scene.points_px, scene.points_in_world, scene.camera
        pose = refine_pose(*arguments, scene.world_from_camera, loss="trivial")
        found.append(
            sigma_px_from_residuals(project_from_world(arguments[1], scene.camera, pose) - arguments[0])
        )
    # Eight residuals less six parameters: without the correction this would be about a half.
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=0.25)


def test_accuracy_is_the_root_of_each_trace():
    position_m, orientation_deg = pose_accuracy(np.diag([1e-4, 2e-4, 1e-4, 0.01, 0.02, 0.06]))
    assert position_m == pytest.approx(0.3)
    assert orientation_deg == pytest.approx(np.degrees(0.02))


def test_points_that_fix_no_pose_are_refused():
    scene = make_scene(np.random.default_rng(5), n=20)
    pose = Pose.identity()
    line = np.linspace(-0.5, 0.5, 20)[:, None] * [1.0, 0.5, 0.2] + [0, 0, 3.0]
    for points in (line, np.tile([0.1, 0.2, 3.0], (20, 1)), -line):
        with pytest.raises(DegenerateGeometryError):
            pose_covariance(np.zeros((20, 2)), points, scene.camera, pose, 1.0)
    with pytest.raises(DegenerateGeometryError):
        pose_covariance(
            scene.points_px[:2], scene.points_in_world[:2], scene.camera, scene.world_from_camera, 1.0
        )
    for bad in (-1.0, np.nan):
        with pytest.raises(InvalidInputError):
            pose_covariance(
                scene.points_px, scene.points_in_world, scene.camera, scene.world_from_camera, bad
            )
