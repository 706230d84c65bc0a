"""Depth between pixels, and depth moved from one camera to another."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.depth import register_depth, sample_depth
from app.geometry.se3 import Pose, rotation_from_vector
from tests.synthetic import CAMERAS, MODELS

Array = NDArray[np.float64]

CAMERA = Camera("PINHOLE", 64, 48, (60.0, 60.0, 31.5, 23.5))
NORMAL, DISTANCE_M = np.array([0.3, -0.5, 0.8]), 1.6  # the plane NORMAL @ X = DISTANCE_M


def grid(camera: Camera) -> Array:
    """Return all pixels (height * width, 2) of a camera, row by row."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    return np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)


def plane_depth(camera: Camera, points_px: Array, from_plane: Pose | None = None) -> Array:
    """Return the z-depth (n,) of the plane, moved by a pose, at pixels (n, 2)."""
    pose = from_plane or Pose.identity()
    normal = pose.rotation @ NORMAL
    rays = camera.unproject(points_px, np.ones(len(points_px)))
    return np.asarray((DISTANCE_M + normal @ pose.translation) / (rays @ normal))


def plane_image(camera: Camera, from_plane: Pose | None = None) -> NDArray[np.float32]:
    depth = plane_depth(camera, grid(camera), from_plane).reshape(camera.height, camera.width)
    return np.where((depth > 0) & (depth < 30), depth, 0).astype(np.float32)


def test_sampling_is_exact_on_planes() -> None:
    points = np.random.default_rng(1).uniform([0, 0], [63, 47], (500, 2))
    sampled = sample_depth(plane_image(CAMERA), points)
    assert sampled.dtype == np.float32
    assert (sampled > 0).all()
    np.testing.assert_allclose(sampled, plane_depth(CAMERA, points), rtol=1e-6)


def test_sampling_at_pixels_returns_them() -> None:
    image = plane_image(CAMERA)
    np.testing.assert_allclose(sample_depth(image, grid(CAMERA)).reshape(48, 64), image, rtol=1e-6)


def test_sampling_outside_and_at_nothing() -> None:
    image = np.ones((4, 5), np.float32)
    points = [[-0.01, 1], [4.01, 1], [1, 3.01], [np.nan, 1], [1, -np.inf], [4, 3], [0, 0]]
    np.testing.assert_array_equal(sample_depth(image, points), [0, 0, 0, 0, 0, 1, 1])
    assert sample_depth(image, np.empty((0, 2))).shape == (0,)
    assert sample_depth(np.ones((1, 5), np.float32), [[2, 0]]).tolist() == [0]


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_one_invalid_neighbour_is_enough(bad: float) -> None:
    image = np.ones((4, 4), np.float32)
    image[1, 2] = bad
    points = [[1.5, 0.5], [2.5, 1.5], [1.01, 1.99], [0.5, 0.5], [2.5, 2.5]]
    np.testing.assert_array_equal(sample_depth(image, points), [0, 0, 0, 1, 1])


def test_edges_are_refused_and_slopes_are_not() -> None:
    image = np.ones((4, 6), np.float32)
    image[:, 3:] = 1.06
    np.testing.assert_array_equal(sample_depth(image, [[2.5, 1.5], [2.0, 1.0], [1.5, 1.5]]), [0, 0, 1])
    image[:, 3:] = 1.03
    assert sample_depth(image, [[2.5, 1.5]])[0] == pytest.approx(2 / (1 + 1 / 1.03))


# Moved 2.5 cm and turned by a degree, as colour and depth cameras in one housing are.
COLOR_FROM_DEPTH = Pose(rotation_from_vector([0.01, -0.012, 0.006]), np.array([-0.025, 0.002, 0.003]))


@pytest.mark.parametrize("model", MODELS)
def test_a_plane_is_registered_exactly_for_every_lens(model: str) -> None:
    depth_camera, color_camera = Camera("PINHOLE", 640, 480, (400.0, 400.0, 320.0, 240.0)), CAMERAS[model]
    registered = register_depth(plane_image(depth_camera), depth_camera, color_camera, COLOR_FROM_DEPTH)
    expected = plane_image(color_camera, COLOR_FROM_DEPTH)
    found = registered > 0
    assert registered.dtype == np.float32
    assert registered.shape == (480, 640)
    np.testing.assert_allclose(registered[found], expected[found], rtol=2e-3)
    assert np.median(np.abs(registered / np.maximum(expected, 1e-6) - 1)[found]) < 1e-4
    # What both see is found, unless at so flat an angle that it looks like an edge.
    near = (expected > 0) & (expected < 6)
    points_in_color = color_camera.unproject(grid(color_camera)[near.ravel()], expected[near])
    in_depth_px = depth_camera.project(COLOR_FROM_DEPTH.inverse().apply(points_in_color))
    seen = (in_depth_px > 2).all(axis=1) & (in_depth_px < [637, 477]).all(axis=1)
    assert seen.sum() > 50_000
    assert found[near][seen].all()


@pytest.mark.parametrize("model", MODELS)
def test_a_depth_camera_may_have_any_lens(model: str) -> None:
    depth_camera, color_camera = CAMERAS[model], Camera("PINHOLE", 640, 480, (700.0, 700.0, 320.0, 240.0))
    registered = register_depth(plane_image(depth_camera), depth_camera, color_camera, COLOR_FROM_DEPTH)
    expected = plane_image(color_camera, COLOR_FROM_DEPTH)
    np.testing.assert_allclose(registered[100:-100, 100:-100], expected[100:-100, 100:-100], rtol=2e-3)


@pytest.mark.parametrize(
    ("width", "height", "focal"), [(1280, 960, 1050.0), (320, 240, 262.5), (200, 150, 160.0)]
)
def test_another_resolution_leaves_no_holes(width: int, height: int, focal: float) -> None:
    depth_camera = Camera("PINHOLE", 320, 240, (250.0, 250.0, 159.5, 119.5))
    color_camera = Camera("PINHOLE", width, height, (focal, focal, (width - 1) / 2, (height - 1) / 2))
    registered = register_depth(plane_image(depth_camera), depth_camera, color_camera, COLOR_FROM_DEPTH)
    inner = (slice(height // 6, -height // 6), slice(width // 6, -width // 6))
    np.testing.assert_allclose(
        registered[inner], plane_image(color_camera, COLOR_FROM_DEPTH)[inner], rtol=2e-3
    )


def test_the_same_camera_changes_nothing() -> None:
    image = plane_image(CAMERA)
    image[10:20, 10:20] = 0
    np.testing.assert_allclose(register_depth(image, CAMERA, CAMERA, Pose.identity()), image, rtol=1e-6)


def test_what_the_colour_camera_cannot_see_stays_hidden() -> None:
    """A box 1 m away before a wall 3 m away; the colour camera is 20 cm to the right of the depth camera."""
    camera = Camera("PINHOLE", 320, 240, (300.0, 300.0, 159.5, 119.5))
    image = np.full((240, 320), 3.0, np.float32)
    image[80:160, 130:190] = 1.0
    registered = register_depth(image, camera, camera, Pose(np.eye(3), np.array([-0.2, 0.0, 0.0])))
    # The box moves by 60 pixels and the wall by 20; the wall uncovered at the box's right has no depth.
    inside = registered[82:158]
    assert (inside[:, 72:128] == 1.0).all()
    assert (inside[:, :68] == 3.0).all()
    assert (inside[:, 134:166] == 0).all()
    assert (inside[:, 172:298] == 3.0).all()
    assert set(np.unique(registered)) <= {0.0, 1.0, 3.0}


def test_points_behind_the_colour_camera_are_not_seen() -> None:
    turned = Pose(rotation_from_vector([0.0, np.pi, 0.0]), np.zeros(3))
    assert not register_depth(plane_image(CAMERA), CAMERA, CAMERA, turned).any()


def test_an_empty_image_stays_empty() -> None:
    assert not register_depth(np.zeros((48, 64), np.float32), CAMERA, CAMERA, COLOR_FROM_DEPTH).any()


def test_depth_of_another_size_than_its_camera() -> None:
    with pytest.raises(ValueError, match="64 x 48"):
        register_depth(np.zeros((48, 63), np.float32), CAMERA, CAMERA, Pose.identity())


def test_registration_keeps_up_with_a_camera() -> None:
    """About 30 ms on one thread; the bound is for a busy machine."""
    depth_camera = Camera("PINHOLE", 640, 480, (585.0, 585.0, 320.0, 240.0))
    color_camera = Camera("PINHOLE", 640, 480, (525.0, 525.0, 320.0, 240.0))
    image = plane_image(depth_camera)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        spent = []
        for _ in range(5):
            start = time.thread_time()
            register_depth(image, depth_camera, color_camera, COLOR_FROM_DEPTH)
            spent.append(time.thread_time() - start)
    finally:
        cv2.setNumThreads(threads)
    assert min(spent) < 0.15
