"""The side of a marker is that of one square fitted to all pictures."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.structure.markers import SQUARE, side_of
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.camera import Camera
from tests.scenes import pose_at

Array = NDArray[np.float64]
CAMERA = Camera("PINHOLE", 640, 480, (525.0, 525.0, 319.5, 239.5))
SIDE_M = 0.17
# On a wall at y = 2, the top left corner as seen by one who looks along y.
CORNERS_M = np.stack([SQUARE[:, 0], np.zeros(4), SQUARE[:, 1]], axis=1) * SIDE_M + [0.0, 2.0, 1.5]


def seen_from(places: list[float]) -> tuple[Reconstruction, dict[int, Array]]:
    """Return a part of pictures along the wall, whose points are on it, and the corners in each, off by 0.3 px."""
    rng = np.random.default_rng(7)
    poses = {row: pose_at(x, 0.6, 1.5, 90.0 + 20.0 * x, 2.0) for row, x in enumerate(places)}
    points = np.stack([rng.uniform(-1, 1, 200), np.full(200, 2.0), rng.uniform(1, 2, 200)], axis=1)
    rows = [(row, number, number) for row in poses for number in range(len(points))]
    views = {
        row: CAMERA.project(pose.inverse().apply(CORNERS_M)) + rng.normal(0, 0.3, (4, 2))
        for row, pose in poses.items()
    }
    part = Reconstruction(
        camera=CAMERA, poses=poses, points=points, observations=np.array(rows, np.intp), error_px=0.3
    )
    return part, views


def test_the_side_is_found_by_all_corners_together() -> None:
    part, views = seen_from([-0.5, -0.3, -0.1, 0.1, 0.3, 0.5])
    assert side_of(part, views) == pytest.approx(SIDE_M, rel=0.01)


def test_a_picture_that_shows_something_else_is_left_out() -> None:
    part, views = seen_from([-0.5, -0.3, -0.1, 0.1, 0.3, 0.5])
    views[3] = views[3] + 40.0
    assert side_of(part, views) == pytest.approx(SIDE_M, rel=0.01)


def test_pictures_from_one_place_show_no_side() -> None:
    assert side_of(*seen_from([0.1, 0.101, 0.102, 0.103])) is None
    assert side_of(*seen_from([-0.5, 0.5])) is None
