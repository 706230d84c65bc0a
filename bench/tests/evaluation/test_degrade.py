"""Degraded pictures: the world stays where the degraded camera says it is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.camera import Camera
from bench.evaluation.degrade import DEGRADATIONS, degrade, motion_kernel
from bench.evaluation.variations import PLAIN, VARIATIONS, parse_variations
from tests.scenes import CAMERA, Room, View, pose_at

LENS = Camera("OPENCV", 320, 240, (262.5, 258.0, 152.0, 121.0, 0.12, -0.08, 0.01, -0.006))
FULL_LENS = Camera("FULL_OPENCV", 320, 240, (*LENS.params, 0.02, 0.01, 0.0, 0.0))
FISHEYE = Camera("OPENCV_FISHEYE", 320, 240, (150.0, 151.0, 158.0, 122.0, 0.02, -0.01, 0.003, 0.0))
CAMERAS = {camera.model: camera for camera in (CAMERA, LENS, FULL_LENS, FISHEYE)}
# A bright spot of this many pixels across survives blur and half the size.
SPOT_PX = 9
WORLD_FROM_CAMERA = pose_at(1.0, 2.0, yaw_deg=30, pitch_deg=-5)


def picture_of(point_in_world: np.ndarray, camera: Camera) -> np.ndarray:
    """Return a black picture with a white spot where the camera sees a point."""
    pixel = camera.project(WORLD_FROM_CAMERA.inverse().apply(point_in_world[None]))[0]
    v, u = np.mgrid[: camera.height, : camera.width]
    spot = np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / (2 * (SPOT_PX / 3) ** 2))
    return np.repeat((255 * spot[..., None]).astype(np.uint8), 3, axis=2)


def centre_of_light(rgb: np.ndarray) -> np.ndarray:
    weight = rgb[..., 0].astype(np.float64)
    weight[weight < 0.2 * weight.max()] = 0
    v, u = np.mgrid[: rgb.shape[0], : rgb.shape[1]]
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("model", CAMERAS)
@pytest.mark.parametrize("name", [name for name in DEGRADATIONS if name != "occluded"])
def test_a_world_point_is_where_the_degraded_camera_projects_it(name: str, model: str) -> None:
    camera = CAMERAS[model]
    # Near the middle, so that every crop holds it, but off both axes.
    point_in_world = WORLD_FROM_CAMERA.apply(camera.unproject([[173.0, 107.0]], [2.5]))[0]
    degraded = degrade(name, picture_of(point_in_world, camera), camera, "frame 1")
    assert degraded.rgb.shape == (degraded.camera.height, degraded.camera.width, 3)
    world_from_degraded = WORLD_FROM_CAMERA @ degraded.original_from_degraded
    expected = degraded.camera.project(world_from_degraded.inverse().apply(point_in_world[None]))[0]
    assert centre_of_light(degraded.rgb) == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("model", CAMERAS)
def test_a_turned_lens_bends_as_it_did(model: str) -> None:
    camera = CAMERAS[model]
    pixels = np.array([[20.0, 15.0], [300.0, 30.0], [160.0, 120.0], [40.0, 220.0]])
    points = camera.unproject(pixels, np.full(4, 2.0))
    turned = degrade("rot90", np.zeros((240, 320, 3), np.uint8), camera, "")
    seen = turned.camera.project(turned.original_from_degraded.inverse().apply(points))
    assert seen == pytest.approx(np.stack([239 - pixels[:, 1], pixels[:, 0]], axis=1), abs=1e-3)


def test_a_turn_moves_the_pixels_as_the_camera_says() -> None:
    rgb = np.zeros((240, 320, 3), np.uint8)
    rgb[10, 300] = 255
    turned = degrade("rot90", rgb, CAMERA, "")
    assert np.argwhere(turned.rgb[..., 0]).tolist() == [[300, 229]]


def test_a_narrow_view_is_that_of_the_crop(room: Room, views: list[View]) -> None:
    pose = views[3].world_from_camera
    narrow = degrade("narrow", views[3].rgb, CAMERA, "frame")
    assert (narrow.camera.width, narrow.camera.height) == (224, 168)
    rendered = room.view(pose, narrow.camera).rgb
    assert np.abs(rendered.astype(int) - narrow.rgb).max() <= 1


@pytest.mark.parametrize("name", DEGRADATIONS)
def test_the_same_seed_gives_the_same_picture(name: str, views: list[View]) -> None:
    before = views[0].rgb.copy()
    first, again = (degrade(name, views[0].rgb, CAMERA, "a") for _ in range(2))
    assert np.array_equal(first.rgb, again.rgb)
    assert first.camera == again.camera
    assert np.array_equal(views[0].rgb, before)


@pytest.mark.parametrize("name", ["blur", "occluded", "crop70"])
def test_another_frame_gets_another_place(name: str, views: list[View]) -> None:
    pictures = [degrade(name, views[0].rgb, CAMERA, str(seed)).rgb for seed in range(4)]
    assert not all(np.array_equal(pictures[0], other) for other in pictures[1:])


def test_what_the_degradations_say_of_themselves(views: list[View]) -> None:
    rgb = views[0].rgb
    hidden = np.any(degrade("occluded", rgb, CAMERA, "a").rgb != rgb, axis=2)
    assert 0.27 < hidden.mean() <= 0.31
    assert degrade("dark", rgb, CAMERA, "a").rgb.mean() == pytest.approx(0.4 * rgb.mean(), rel=0.02)
    assert np.array_equal(degrade("none", rgb, CAMERA, "a").rgb, rgb)

    def sharpness(image: np.ndarray) -> float:
        return float(cv2.Laplacian(image, cv2.CV_64F).var())

    assert sharpness(degrade("blur", rgb, CAMERA, "a").rgb) < 0.2 * sharpness(rgb)


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, np.pi / 2, 2.5])
def test_motion_is_as_long_as_it_should_be_and_centred(angle_rad: float) -> None:
    kernel = motion_kernel(15, angle_rad)
    v, u = np.indices(kernel.shape) - kernel.shape[0] // 2
    along = u * np.cos(angle_rad) + v * np.sin(angle_rad)
    assert kernel.sum() == pytest.approx(1.0)
    assert [(kernel * u).sum(), (kernel * v).sum()] == pytest.approx([0, 0], abs=1e-9)
    # A line of length 14 between the outer pixel centres has a variance of 14^2 / 12 along itself.
    assert np.sqrt(12 * (kernel * along**2).sum()) == pytest.approx(14.0, abs=0.6)


def test_variations_are_named_once_and_all_means_all() -> None:
    assert parse_variations([]) == (PLAIN,)
    assert [each.name for each in parse_variations(["half", "none", "half"])] == ["half", "none"]
    assert parse_variations(["dark", "all"])[0].name == "dark"
    assert {each.name for each in parse_variations(["all"])} == set(VARIATIONS)
    with pytest.raises(InvalidInputError, match="no-camera-mixed"):
        parse_variations(["upside-down"])


def test_mixed_means_every_second_query(views: list[View]) -> None:
    mixed = VARIATIONS["no-camera-mixed"]
    sizes = [mixed.apply(number, "a", views[0].rgb, CAMERA).camera.width for number in range(4)]
    assert sizes == [320, 224, 320, 224]
    assert not mixed.camera_given
