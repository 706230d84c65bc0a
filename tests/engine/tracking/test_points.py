"""Points that odometry places: their distance gets certain as the camera moves, and only then."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.tracking.odometry.points import TrackedPoints
from app.geometry.reprojection import project_from_world
from app.geometry.se3 import Pose
from tests.scenes import CAMERA

RNG = np.random.default_rng(4)
TRUTH = RNG.uniform([-0.6, -0.4, 1.5], [0.6, 0.4, 3.0], (40, 3))


def seen_from(x_m: float) -> tuple[Pose, np.ndarray]:
    pose = Pose(np.eye(3), np.array([x_m, 0.0, 0.0]))
    return pose, project_from_world(TRUTH, CAMERA, pose)


def new_points() -> TrackedPoints:
    pose, pixels = seen_from(0.0)
    return TrackedPoints.new(np.arange(len(TRUTH)), pixels, CAMERA, pose, 2.2)


def test_a_camera_that_moves_places_points() -> None:
    points = new_points()
    assert not points.is_placed.any()
    for step in range(1, 13):
        pose, points.pixels = seen_from(0.03 * step)
        points.observe(CAMERA, pose)
    assert points.is_placed.all()
    errors = np.linalg.norm(points.points_in_frame - TRUTH, axis=1)
    assert np.median(errors) < 0.03


def test_a_camera_that_stays_learns_nothing() -> None:
    points = new_points()
    before = points.inverse_sigma.copy()
    for _ in range(30):
        pose, points.pixels = seen_from(0.0)
        points.observe(CAMERA, pose)
    assert points.inverse_sigma == pytest.approx(before, rel=1e-3)
    assert not points.is_placed.any()
    # Seen from where it was first seen, an unknown distance doesn't matter; from aside it does.
    assert points.sigma_across_m(np.zeros(3)).max() < 1e-6
    assert points.sigma_across_m(np.array([0.5, 0.0, 0.0])).min() > 0.05


def test_points_of_a_fix_stay_where_they_are() -> None:
    pose, pixels = seen_from(0.0)
    points = TrackedPoints.fixed(np.arange(len(TRUTH)), pixels, TRUTH, np.full(len(TRUTH), 0.01), pose)
    moved, points.pixels = seen_from(0.4)
    points.pixels = points.pixels + 5.0
    points.observe(CAMERA, moved)
    assert np.allclose(points.points_in_frame, TRUTH)
    shift = Pose(np.eye(3), np.array([0.0, 1.0, 0.0]))
    assert np.allclose(points.moved(shift).points_in_frame, TRUTH + shift.translation)
    points.place(np.arange(3), TRUTH[:3] + 0.1)
    assert np.allclose(points.points_in_frame[:3], TRUTH[:3] + 0.1)
