"""Cameras of every model: round trips, derivatives, resizing, and what can't be a camera."""

import numpy as np
import pytest

from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from tests.synthetic import CAMERAS, MODELS, random_pixels


@pytest.mark.parametrize("model", MODELS)
def test_unprojected_pixels_project_to_themselves(model):
    camera, rng = CAMERAS[model], np.random.default_rng(0)
    pixels, depth_m = random_pixels(rng, camera, 500), rng.uniform(0.5, 8.0, 500)
    points = camera.unproject(pixels, depth_m)
    np.testing.assert_allclose(points[:, 2], depth_m)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_projected_points_unproject_to_themselves(model):
    camera, rng = CAMERAS[model], np.random.default_rng(1)
    points = camera.unproject(random_pixels(rng, camera, 300), rng.uniform(0.5, 8.0, 300))
    np.testing.assert_allclose(camera.unproject(camera.project(points), points[:, 2]), points, atol=1e-5)


@pytest.mark.parametrize("model", MODELS)
def test_undistorted_pixels_are_what_a_pinhole_sees(model):
    camera = CAMERAS[model]
    pinhole = Camera("PINHOLE", camera.width, camera.height, camera.params[:4])
    rng = np.random.default_rng(2)
    points = camera.unproject(random_pixels(rng, camera, 100), rng.uniform(1, 4, 100))
    np.testing.assert_allclose(camera.undistort(camera.project(points)), pinhole.project(points), atol=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_projection_jacobian_against_finite_differences(model):
    camera, rng = CAMERAS[model], np.random.default_rng(3)
    points = camera.unproject(random_pixels(rng, camera, 50), rng.uniform(0.5, 5.0, 50))
    (_, jacobian), step = camera.projection_jacobian(points), 1e-6
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        numeric = (camera.project(points + offset) - camera.project(points - offset)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, axis], numeric, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_points_not_in_front_have_no_pixel(model):
    camera = CAMERAS[model]
    points = np.array([[0.1, 0.2, -1.0], [0.1, 0.2, 0.0], [0.1, 0.2, 2.0]])
    pixels, jacobian = camera.project(points), camera.projection_jacobian(points)[1]
    assert np.isnan(pixels[:2]).all()
    assert np.isnan(jacobian[:2]).all()
    assert np.isfinite(pixels[2]).all()
    assert np.isfinite(jacobian[2]).all()
    assert np.isnan(camera.project(points[:2])).all()
    assert np.isnan(camera.projection_jacobian(points[:2])[1]).all()


@pytest.mark.parametrize(
    "camera",
    [
        Camera("OPENCV", 640, 480, (525.0, 525.0, 320.0, 240.0, -0.3, 0.0, 0.0, 0.0)),
        Camera("FULL_OPENCV", 640, 480, (525.0, 525.0, 320.0, 240.0, 0.26, -0.95, 0, 0, 1.16, 0, 0, -0.05)),
        Camera("OPENCV_FISHEYE", 640, 480, (330.0, 330.0, 320.0, 240.0, 0.0, -0.3, 0.0, 0.0)),
    ],
)
def test_a_lens_never_folds_far_points_back_into_the_picture(camera):
    angles = np.linspace(0, 2 * np.pi, 40)
    for tangent in (1.5, 1.8, 6.0, 20.0):
        ring = np.stack([tangent * np.cos(angles), tangent * np.sin(angles), np.ones(40)], axis=1)
        assert not camera.contains(camera.project(ring)).any()


@pytest.mark.parametrize("model", MODELS)
def test_no_points_give_no_pixels(model):
    camera = CAMERAS[model]
    assert camera.project(np.empty((0, 3))).shape == (0, 2)
    assert camera.normalize(np.empty((0, 2))).shape == (0, 2)
    assert camera.projection_jacobian(np.empty((0, 3)))[1].shape == (0, 2, 3)


@pytest.mark.parametrize("model", MODELS)
def test_scaling_keeps_rays(model):
    camera = CAMERAS[model]
    half = camera.scaled_to(320, 240)
    pixels = random_pixels(np.random.default_rng(4), camera, 100)
    # A pixel covers the area half a pixel around its centre, and the picture starts at -0.5.
    half_pixels = (pixels + 0.5) / 2 - 0.5
    np.testing.assert_allclose(half.normalize(half_pixels), camera.normalize(pixels), atol=1e-6)
    back = half.scaled_to(640, 480)
    np.testing.assert_allclose(back.params, camera.params)


def test_scaling_to_the_same_size_is_the_same_camera_and_to_another_shape_is_refused():
    camera = CAMERAS["PINHOLE"]
    assert camera.scaled_to(640, 480) is camera
    with pytest.raises(InvalidCameraError, match="aspect ratio"):
        camera.scaled_to(640, 640)


def test_model_follows_the_count_of_values():
    four = (500, 500, 320, 240)
    assert Camera.from_values(four, 640, 480).model == "PINHOLE"
    assert Camera.from_values((*four, 0.1, 0.0, 0.0, 0.0), 640, 480).model == "OPENCV"
    nine = Camera.from_values((*four, 0.1, 0.02, 0.0, 0.0, 0.003), 640, 480)
    assert nine.model == "FULL_OPENCV"
    np.testing.assert_allclose(nine.distortion, [0.1, 0.02, 0, 0, 0.003, 0, 0, 0])
    with pytest.raises(InvalidCameraError):
        Camera.from_values((500, 500, 320), 640, 480)


def test_contains_goes_to_the_edges_of_the_outer_pixels():
    camera = CAMERAS["PINHOLE"]
    points = [[-0.5, -0.5], [639.5, 479.5], [-0.51, 10], [10, 479.6], [np.nan, 1]]
    assert camera.contains(points).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize(
    ("model", "width", "height", "params"),
    [
        ("SIMPLE", 640, 480, (500, 500, 320, 240)),
        ("PINHOLE", 640, 480, (500, 500, 320)),
        ("PINHOLE", 640, 480, (np.nan, 500, 320, 240)),
        ("PINHOLE", 0, 480, (500, 500, 320, 240)),
        ("PINHOLE", 640, 480, (5, 500, 320, 240)),
        ("PINHOLE", 640, 480, (-500, -500, 320, 240)),
        ("PINHOLE", 640, 480, (500, 1500, 320, 240)),
        ("PINHOLE", 640, 480, (500, 500, 3200, 240)),
        ("OPENCV", 640, 480, (500, 500, 320, 240, 100, 0, 0, 0)),
    ],
)
def test_impossible_intrinsics_are_refused(model, width, height, params):
    with pytest.raises(InvalidCameraError):
        Camera(model, width, height, tuple(float(p) for p in params))


def test_a_fisheye_is_always_distorted_and_zero_coefficients_are_not():
    assert Camera("OPENCV_FISHEYE", 640, 480, (330.0, 330.0, 320.0, 240.0, 0, 0, 0, 0)).is_distorted
    assert not Camera("OPENCV", 640, 480, (500.0, 500.0, 320.0, 240.0, 0, 0, 0, 0)).is_distorted
