"""The step between two frames by their matches alone: its turn needs no distances, its length those of the plan."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.tracking.plan_walk.two_views import FrameMatches, pose_by_two_views
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, attitude_difference_rad, rotation_from_vector

Array = NDArray[np.float64]
CAMERA = Camera("PINHOLE", 400, 300, (311.0, 311.0, 199.5, 149.5))


def room(rng: np.random.Generator, count: int) -> Array:
    """Return points (n, 3) at distances from 2 to 6 m ahead of a camera in its own axes, to its right as well."""
    away_m = rng.uniform(2.0, 6.0, count)
    return (
        np.column_stack(
            [rng.uniform(-0.5, 0.9, (count, 1)), rng.uniform(-0.4, 0.4, (count, 1)), np.ones(count)]
        )
        * (away_m[:, None])
    )


def matches_of(
    now: Pose, *, false: int = 0, count: int = 150
) -> tuple[FrameMatches, dict[tuple[float, float], float]]:
    """Return matches of a camera at the origin and at a pose, and how far away what each shows is from the origin."""
    rng = np.random.default_rng(3)
    points = room(rng, count)
    seen_now = now.inverse().apply(points)
    before_px, now_px = CAMERA.project(points), CAMERA.project(seen_now)
    now_px[:false] = rng.uniform(0.0, 300.0, (false, 2))
    before_px, now_px = (
        before_px + rng.normal(0.0, 0.4, before_px.shape),
        now_px + rng.normal(0.0, 0.4, now_px.shape),
    )
    away_m = np.linalg.norm(points, axis=1)
    return FrameMatches(before_px, now_px), {
        (float(u), float(v)): float(m) for (u, v), m in zip(before_px, away_m, strict=True)
    }


def turned(deg: float, moved: tuple[float, float, float]) -> Pose:
    """Return a camera turned about its upright axis and moved."""
    return Pose(rotation_from_vector(np.array([0.0, np.radians(deg), 0.0])), np.array(moved))


@pytest.mark.parametrize("wrong", [0.6, 1.0, 1.7])
def test_a_turn_is_right_however_wrong_the_distances_are(wrong: float) -> None:
    now = turned(11.0, (0.05, 0.0, 0.28))
    matches, away_m = matches_of(now, false=40)
    found = pose_by_two_views(
        matches,
        Pose.identity(),
        lambda pixels, _camera, _pose: wrong * np.array([away_m[float(u), float(v)] for u, v in pixels]),
        CAMERA,
    )
    assert found is not None
    assert np.degrees(attitude_difference_rad(found, now)) < 0.7
    # The length is as wrong as the distances are.
    assert np.linalg.norm(found.translation) == pytest.approx(
        wrong * np.linalg.norm(now.translation), rel=0.15
    )


def test_a_turn_on_the_spot_has_no_length() -> None:
    now = turned(-12.0, (0.0, 0.0, 0.0))
    matches, away_m = matches_of(now)
    found = pose_by_two_views(
        matches,
        Pose.identity(),
        lambda pixels, _camera, _pose: np.array([away_m[float(u), float(v)] for u, v in pixels]),
        CAMERA,
    )
    assert found is not None
    assert np.degrees(attitude_difference_rad(found, now)) < 0.7
    assert np.linalg.norm(found.translation) < 0.05


def test_matches_by_chance_are_no_step() -> None:
    rng = np.random.default_rng(5)
    matches = FrameMatches(rng.uniform(0.0, 300.0, (80, 2)), rng.uniform(0.0, 300.0, (80, 2)))
    found = pose_by_two_views(
        matches, Pose.identity(), lambda pixels, _camera, _pose: np.full(len(pixels), 3.0), CAMERA
    )
    assert found is None
