"""Depth along rays: other views correct a sensor that is off, and where they can't, the sensor's value stays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from app.geometry.ray_depth import (
    OPTIONS,
    Observations,
    RefinedDepth,
    median_by_row,
    refine_depth_along_rays,
)
from app.geometry.se3 import Pose, rotation_from_vector
from tests.synthetic import CAMERAS, random_pixels, random_pose

CAMERA = CAMERAS["PINHOLE"]
BIAS = 1.04
BASELINES_M = ([0.4, 0.0, 0.0], [-0.3, 0.2, 0.05], [0.1, -0.35, 0.1])


def refine(
    offsets: Sequence[Sequence[float]],
    *,
    bias: float = BIAS,
    noise_px: float = 0.0,
    wrong_share: float = 0.0,
    n: int = 150,
) -> tuple[NDArray[np.float64], RefinedDepth]:
    """Return true depths (n,), and those refined from biased ones by views moved by `offsets` in camera axes."""
    rng = np.random.default_rng(5)
    world_from_camera = random_pose(rng)
    pixels, true_m = random_pixels(rng, CAMERA, n), rng.uniform(1.0, 4.0, n)
    points = world_from_camera.apply(CAMERA.unproject(pixels, true_m))
    parts = []
    for offset in offsets:
        turn = rotation_from_vector(rng.normal(size=3) * 0.05)
        camera_from_world = (world_from_camera @ Pose(turn, np.array(offset))).inverse()
        seen = CAMERA.project(camera_from_world.apply(points)) + rng.normal(size=(n, 2)) * noise_px
        wrong = rng.random(n) < wrong_share
        seen[wrong] += rng.normal(size=(int(wrong.sum()), 2)) * 40
        rows = np.flatnonzero(np.isfinite(seen).all(axis=1))
        parts.append((rows, CAMERA.normalize(seen[rows]), camera_from_world))
    rays = CAMERA.unproject(pixels, np.ones(n)) @ world_from_camera.rotation.T
    return true_m, refine_depth_along_rays(
        rays, world_from_camera.translation, bias * true_m, observations(parts)
    )


def observations(parts: Sequence[tuple[NDArray[np.intp], NDArray[np.float64], Pose]]) -> Observations:
    counts = [len(rows) for rows, _, _ in parts]
    return Observations(
        np.concatenate([rows for rows, _, _ in parts]),
        np.concatenate([normalized for _, normalized, _ in parts]),
        np.full(sum(counts), CAMERA.focal_px),
        np.repeat(np.stack([pose.rotation for _, _, pose in parts]), counts, axis=0),
        np.repeat(np.stack([pose.translation for _, _, pose in parts]), counts, axis=0),
    )


def relative_errors(true_m: NDArray[np.float64], refined: RefinedDepth) -> NDArray[np.float64]:
    return np.abs(refined.depth_m / true_m - 1)


@pytest.mark.parametrize("views", [1, 2, 3])
@pytest.mark.parametrize("bias", [0.95, 1.04])
def test_views_with_parallax_take_a_sensors_bias_out(views: int, bias: float) -> None:
    true_m, refined = refine(BASELINES_M[:views], bias=bias)
    # The prior keeps its share: the less, the more parallax there is.
    assert np.median(relative_errors(true_m, refined)) < 0.2 * abs(bias - 1)
    assert (relative_errors(true_m, refined) < abs(bias - 1) + 1e-9).all()
    assert (refined.views == views).all()
    assert np.median(refined.error_px) < 1.0


@pytest.mark.parametrize("baseline_m", [0.05, 0.15, 0.4])
def test_sensor_and_views_are_weighed_by_their_information(baseline_m: float) -> None:
    true_m, refined = refine([[baseline_m, 0.0, 0.0]])
    prior, total = OPTIONS.prior_sigma_ratio**-2, (refined.depth_m / refined.sigma_m) ** 2
    # The optimum of a quadratic between the sensor's logarithm of the depth and that of the views.
    assert np.allclose(np.log(refined.depth_m / true_m), np.log(BIAS) * prior / total, rtol=0.1, atol=2e-4)


def test_a_correct_sensor_is_left_alone() -> None:
    true_m, refined = refine(BASELINES_M, bias=1.0)
    assert relative_errors(true_m, refined).max() < 1e-6
    assert refined.error_px.max() < 1e-3


def test_without_parallax_the_sensor_holds() -> None:
    true_m, refined = refine([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert np.allclose(refined.depth_m, BIAS * true_m, rtol=1e-6)
    assert np.allclose(refined.sigma_m, OPTIONS.prior_sigma_ratio * refined.depth_m)


def test_more_parallax_means_less_uncertainty() -> None:
    medians = []
    for baseline_m in (0.02, 0.1, 0.5):
        true_m, refined = refine([[baseline_m, 0.0, 0.0]], noise_px=0.5)
        assert (refined.sigma_m <= OPTIONS.prior_sigma_ratio * refined.depth_m * (1 + 1e-9)).all()
        medians.append(float(np.median(refined.sigma_m / true_m)))
    assert medians[0] > 1.1 * medians[1] > 2 * medians[2]


def test_wrong_matches_among_right_ones_have_little_say() -> None:
    true_m, refined = refine(
        [*BASELINES_M, [0.2, 0.2, 0.0], [-0.2, -0.2, 0.1]], noise_px=0.5, wrong_share=0.2
    )
    assert np.median(relative_errors(true_m, refined)) < 0.01
    assert np.quantile(relative_errors(true_m, refined), 0.9) < 0.04


def test_points_that_no_view_sees_keep_their_depth() -> None:
    nothing = Observations(
        np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3))
    )
    refined = refine_depth_along_rays(np.array([[0.0, 0.0, 1.0]]), np.zeros(3), np.array([2.0]), nothing)
    assert refined.depth_m == pytest.approx([2.0])
    assert refined.sigma_m == pytest.approx([2.0 * OPTIONS.prior_sigma_ratio])
    assert np.isnan(refined.error_px).all()
    assert refined.views.tolist() == [0]


def test_medians_by_row() -> None:
    rng = np.random.default_rng(0)
    rows, values = rng.integers(0, 9, 60), rng.normal(size=60)
    found = median_by_row(rows, values, 11)
    for row in range(11):
        own = values[rows == row]
        assert np.isnan(found[row]) if len(own) == 0 else found[row] == pytest.approx(np.median(own))
    assert np.isnan(median_by_row(np.zeros(0, np.intp), np.zeros(0), 2)).all()
