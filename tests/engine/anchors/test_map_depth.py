"""The distances of what a camera sees by a map: near verified points, and not behind a wall."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.anchors.map_depth import STEPS_PER_M, SeenPoints, points_seen
from app.geometry.camera import Camera
from tests.scenes import CAMERA, pose_at

POSE = pose_at(1.0, 1.0, 1.5)
GRID = np.array([[u, v] for u in range(56, 265, 3) for v in range(56, 185, 3)], dtype=np.float64)


def wall(depth_m: float) -> np.ndarray:
    """Return the world points of a wall across the camera's view."""
    return POSE.apply(CAMERA.unproject(GRID, np.full(len(GRID), depth_m)))


def test_points_beside_recognised_ones_are_taken_and_hidden_ones_are_not() -> None:
    near, behind = wall(2.0), wall(3.5)
    known = slice(None, None, 5)
    seen = points_seen(CAMERA, POSE, GRID[known], near[known], np.concatenate([near, behind]))
    assert len(seen.pixels) > 0.8 * len(GRID)
    depths = seen.lengths_m / np.linalg.norm(CAMERA.unproject(seen.pixels, np.ones(len(seen.pixels))), axis=1)
    assert np.allclose(depths, 2.0, atol=1e-6)
    lengths = seen.lengths_at(np.array([[160.0, 120.0], [10.0, 10.0]]), CAMERA)
    assert abs(lengths[0] - 2.0) < 0.02
    assert np.isnan(lengths[1])


def test_nothing_recognised_tells_nothing() -> None:
    seen = points_seen(CAMERA, POSE, np.zeros((0, 2)), np.zeros((0, 3)), wall(2.0))
    assert len(seen.pixels) == 0
    assert np.isnan(seen.lengths_at(GRID, CAMERA)).all()


def test_packed_points_come_back_in_a_frame_of_another_size() -> None:
    seen = SeenPoints(GRID, np.linspace(0.5, 40.0, len(GRID)))
    again = SeenPoints.unpack(seen.pack(CAMERA), CAMERA)
    assert np.allclose(again.pixels, GRID, atol=0.01)
    assert np.allclose(again.lengths_m, seen.lengths_m, atol=0.5 / STEPS_PER_M + 1e-9)
    double = Camera("PINHOLE", 640, 480, tuple(2 * value for value in CAMERA.params))
    assert np.allclose(SeenPoints.unpack(seen.pack(CAMERA), double).pixels, 2 * GRID + 0.5, atol=0.02)


def test_what_is_too_far_to_be_stored_is_left_out() -> None:
    seen = SeenPoints(GRID[:2], np.array([3.0, 80.0]))
    assert SeenPoints.unpack(seen.pack(CAMERA), CAMERA).lengths_m == pytest.approx([3.0])
