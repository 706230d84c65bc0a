"""The response of a depth sensor: found again from depths that are known, and left alone where nothing is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.geometry.depth_response import OPTIONS, DepthResponse, fit_depth_response

Array = NDArray[np.float64]
TRUE = (0.97, 0.015, -0.02, 0.01)


def scene(n: int = 2000) -> tuple[Array, Array, Array]:
    """Return what a sensor with the response `TRUE` shows (n,), where (n, 2), and the depths (n,)."""
    rng = np.random.default_rng(3)
    shown_m = rng.uniform(0.8, 4.0, n)
    image_plane = rng.uniform(-0.6, 0.6, (n, 2))
    return shown_m, image_plane, DepthResponse(TRUE).correct(shown_m, image_plane)


def test_the_response_is_found_from_known_depths() -> None:
    shown_m, image_plane, depth_m = scene()
    found = fit_depth_response(shown_m, image_plane, depth_m, np.full(len(shown_m), 0.005))
    assert found.coefficients == pytest.approx(TRUE, abs=1e-3)
    inside = (shown_m > found.range_m[0]) & (shown_m < found.range_m[1])
    corrected = found.correct(shown_m, image_plane)
    assert np.abs(corrected / depth_m - 1)[inside].max() < 1e-3


def test_noise_and_edges_of_objects_hardly_move_it() -> None:
    rng = np.random.default_rng(4)
    shown_m, image_plane, depth_m = scene()
    edge = rng.random(len(shown_m)) < 0.2
    shown_m = shown_m * (
        1 + 0.01 * rng.normal(size=len(shown_m)) + edge * rng.uniform(0.1, 0.3, len(shown_m))
    )
    found = fit_depth_response(shown_m, image_plane, depth_m, np.full(len(shown_m), 0.005))
    clean = ~edge
    before = np.median(np.abs(shown_m / depth_m - 1)[clean])
    assert np.median(np.abs(found.correct(shown_m, image_plane) / depth_m - 1)[clean]) < 0.6 * before


def test_few_or_uncertain_depths_leave_the_sensor_alone() -> None:
    shown_m, image_plane, depth_m = scene(OPTIONS.min_points - 1)
    assert fit_depth_response(shown_m, image_plane, depth_m, np.full(len(shown_m), 1e-3)) == DepthResponse()
    shown_m, image_plane, depth_m = scene(OPTIONS.min_points)
    vague = fit_depth_response(shown_m, image_plane, depth_m, np.full(OPTIONS.min_points, 10.0))
    assert vague.coefficients == pytest.approx(DepthResponse().coefficients, abs=1e-3)
    assert fit_depth_response(np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros(0)) == DepthResponse()


def test_no_depth_stays_none_and_depths_beyond_the_known_are_not_extrapolated() -> None:
    response = DepthResponse((0.97, 0.015, 0.0, 0.0), (1.0, 3.0))
    corrected = response.correct(np.array([0.0, 3.0, 30.0]), np.zeros((3, 2)))
    assert corrected[0] == 0
    assert corrected[2] == pytest.approx(10 * corrected[1])
