"""Uniform motion (B eq. 2): positions, and a camera that looks where it goes, upright."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.uniform_motion import UniformMotion


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, -135.0, 720.5])
def test_positions_are_those_of_the_formula(direction_deg: float) -> None:
    motion = UniformMotion((1.0, 2.0, 1.5), 0.8, direction_deg, 30.0)
    angle = np.radians(direction_deg)
    for n in (0, 1, 45, 3000):
        x, y = 1.0 + 0.8 * n / 30.0 * np.cos(angle), 2.0 + 0.8 * n / 30.0 * np.sin(angle)
        assert motion.position(n) == pytest.approx([x, y, 1.5])


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, -135.0])
def test_the_camera_looks_along_the_walk_and_stands_upright(direction_deg: float) -> None:
    motion = UniformMotion((0.0, 0.0, 1.5), 1.0, direction_deg, 10.0)
    pose = motion.pose(10)
    ahead = motion.position(11) - motion.position(10)
    assert pose.apply([0.0, 0.0, 0.1]) == pytest.approx(pose.translation + ahead)
    assert pose.apply([0.0, 1.0, 0.0]) == pytest.approx(pose.translation - [0.0, 0.0, 1.0])
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "values",
    [
        ((0, 0, 0), 0.0, 0.0, 30.0),
        ((0, 0, 0), -1.0, 0.0, 30.0),
        ((0, 0, 0), 1.0, 0.0, 0.0),
        ((0, 0, 0), 1.0, np.nan, 30.0),
        ((0, np.inf, 0), 1.0, 0.0, 30.0),
        ((0, 0, 0), 500.0, 0.0, 30.0),
        ((0, 0, 0), 1.0, 0.0, 1e6),
    ],
)
def test_what_cannot_be_meant_is_refused(
    values: tuple[tuple[float, float, float], float, float, float],
) -> None:
    with pytest.raises(InvalidInputError):
        UniformMotion(*values)
