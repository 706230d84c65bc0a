"""The search for a focal length: found with depth in the picture, refused where nothing tells it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.covariance import pose_accuracy, pose_covariance
from app.geometry.focal import (
    OPTIONS,
    ApproximateCamera,
    find_camera,
    pinhole,
    search_camera,
)
from app.geometry.se3 import Pose
from tests.synthetic import random_pixels, random_pose

WIDTH, HEIGHT = 640, 480
MAX_ERROR = 6.0 / 525.0
Array = NDArray[np.float64]


def matches(
    focal_px: float,
    *,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    noise_px: float = 0.5,
    outlier_ratio: float = 0.3,
    nearest_m: float = 1.0,
    n: int = 200,
    seed: int = 1,
) -> tuple[Array, Array]:
    """Return pixels (n, 2) and world points (n, 3) of a camera of that focal length, some of them wrong."""
    rng = np.random.default_rng(seed)
    camera = pinhole(*size, focal_px)
    pixels = random_pixels(rng, camera, n)
    points = random_pose(rng).apply(camera.unproject(pixels, rng.uniform(nearest_m, 5.0, n)))
    seen = pixels + rng.normal(size=(n, 2)) * noise_px
    wrong = rng.permutation(n) < outlier_ratio * n
    seen[wrong] = random_pixels(rng, camera, int(wrong.sum()))
    return seen, points


@pytest.mark.parametrize("size", [(640, 480), (480, 640), (1920, 1080)], ids=str)
@pytest.mark.parametrize("ratio", [0.55, 0.8, 1.2, 1.7])
def test_the_focal_length_is_found(ratio: float, size: tuple[int, int]) -> None:
    focal_px = ratio * max(size)
    camera = search_camera(*matches(focal_px, size=size), *size, MAX_ERROR, 20)
    assert camera is not None
    assert camera.focal_px == pytest.approx(focal_px, rel=0.02)
    assert (camera.model, camera.width, camera.height) == ("PINHOLE", *size)
    assert camera.params[2:] == (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))


@pytest.mark.parametrize("seed", range(5))
def test_noise_moves_it_little(seed: int) -> None:
    camera = search_camera(*matches(500.0, noise_px=1.5, seed=seed), WIDTH, HEIGHT, MAX_ERROR, 20)
    assert camera is not None
    assert camera.focal_px == pytest.approx(500.0, rel=0.06)


@pytest.mark.parametrize("ratio", [0.7 * OPTIONS.min_focal_ratio, 1.6 * OPTIONS.max_focal_ratio])
def test_a_lens_that_no_phone_has_is_not_taken_for_the_nearest_one(ratio: float) -> None:
    camera = search_camera(*matches(ratio * WIDTH, outlier_ratio=0.0), WIDTH, HEIGHT, MAX_ERROR, 20)
    low, high = OPTIONS.min_focal_ratio, OPTIONS.max_focal_ratio
    assert camera is None or not low * 1.1 < camera.focal_px / WIDTH < high / 1.1


def test_without_enough_matches_there_is_none() -> None:
    pixels, points = matches(500.0, n=30, outlier_ratio=0.0)
    assert search_camera(pixels, points, WIDTH, HEIGHT, MAX_ERROR, 31) is None
    assert search_camera(pixels[:3], points[:3], WIDTH, HEIGHT, MAX_ERROR, 1) is None
    assert search_camera(pixels[:0], points[:0], WIDTH, HEIGHT, MAX_ERROR, 1) is None


def test_matches_that_are_all_wrong_give_none() -> None:
    pixels, points = matches(500.0, outlier_ratio=1.0)
    assert search_camera(pixels, points, WIDTH, HEIGHT, MAX_ERROR, 20) is None


def test_the_search_is_repeatable() -> None:
    a, b = (search_camera(*matches(500.0), WIDTH, HEIGHT, MAX_ERROR, 20) for _ in range(2))
    assert a == b


@pytest.mark.parametrize("error", [0.0, 0.03, -0.03, 0.08, -0.08])
def test_a_rough_focal_length_is_refined(error: float) -> None:
    near = ApproximateCamera(pinhole(WIDTH, HEIGHT, 500.0 * (1 + error)))
    camera = find_camera(*matches(500.0), WIDTH, HEIGHT, MAX_ERROR, 20, near)
    assert camera is not None
    assert camera.focal_px == pytest.approx(500.0, rel=0.015)


@pytest.mark.parametrize("factor", [0.6, 0.75, 1.4, 1.7])
def test_a_focal_length_far_from_what_was_said_is_searched_for(factor: float) -> None:
    near = ApproximateCamera(pinhole(WIDTH, HEIGHT, 500.0 * factor))
    camera = find_camera(*matches(500.0), WIDTH, HEIGHT, MAX_ERROR, 20, near)
    assert camera is not None
    assert camera.focal_px == pytest.approx(500.0, rel=0.03)
    assert not near.covers(camera)


def flat_wall(focal_px: float) -> tuple[Array, Array, Pose]:
    """Return pixels and world points of a wall straight ahead, and the pose: focal length and distance trade off."""
    rng, camera = np.random.default_rng(0), pinhole(WIDTH, HEIGHT, focal_px)
    pixels, pose = random_pixels(rng, camera, 300), random_pose(rng)
    points = pose.apply(camera.unproject(pixels, np.full(300, 2.0)))
    return pixels + rng.normal(size=(300, 2)) * 0.5, points, pose


def test_before_a_flat_wall_the_focal_length_stays_as_it_was_said() -> None:
    pixels, points, _ = flat_wall(500.0)
    near = ApproximateCamera(pinhole(WIDTH, HEIGHT, 515.0))
    camera = find_camera(pixels, points, WIDTH, HEIGHT, MAX_ERROR, 20, near)
    assert camera is not None
    assert camera.focal_px == pytest.approx(515.0, rel=0.02)


def test_the_position_error_of_a_focal_length_is_large_where_nothing_tells_it() -> None:
    pixels, points, pose = flat_wall(500.0)
    camera = pinhole(WIDTH, HEIGHT, 500.0)

    def sigma_m(points_in_world: Array, focal_sigma: float) -> float:
        return pose_accuracy(pose_covariance(pixels, points_in_world, camera, pose, focal_sigma=focal_sigma))[
            0
        ]

    # Five percent of two metres.
    assert sigma_m(points, 0.05) == pytest.approx(0.1, rel=0.2)
    try:
        unknown_m = sigma_m(points, float("inf"))
    except DegenerateGeometryError:
        unknown_m = float("inf")
    assert unknown_m > 0.5
    rng = np.random.default_rng(1)
    deep = pose.apply(camera.unproject(pixels, rng.uniform(1.0, 5.0, len(pixels))))
    assert sigma_m(deep, 0.05) < 0.02
    assert sigma_m(points, 0.0) < sigma_m(points, 0.05)
