"""The vertical of a camera by the edges that it sees."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.se3 import rotation_from_vector
from app.geometry.vertical import vertical_direction


def edges(
    rng: np.random.Generator, upright: np.ndarray, direction: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image-plane ends of straight edges along a direction of a room, seen by a camera turned in it."""
    middles = np.column_stack(
        [rng.uniform(-2.5, 2.5, count), rng.uniform(-1.5, 1.5, count), rng.uniform(3, 6, count)]
    )
    ends = [(middles + sign * 0.4 * direction) @ upright.T for sign in (-1.0, 1.0)]
    start, end = (side[:, :2] / side[:, 2:] + rng.normal(0, 2e-4, (count, 2)) for side in ends)
    return start, end


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.5, 0.1), (-0.2, 0.3), (0.3, -0.5)])
def test_it_is_found_among_other_edges(tilt: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    camera_from_room = rotation_from_vector([tilt[0], 0.0, tilt[1]])
    parts = [
        edges(rng, camera_from_room, np.array(direction), count)
        for direction, count in (([0, 1.0, 0], 40), ([1.0, 0, 0], 30), ([0.2, 0.5, 0.8], 20))
    ]
    starts, ends = (np.concatenate(side) for side in zip(*parts, strict=True))
    found = vertical_direction(starts, ends, np.linalg.norm(ends - starts, axis=1))
    assert found is not None
    assert np.degrees(np.arccos(np.clip(found.down @ camera_from_room[:, 1], -1, 1))) < 0.5
    assert found.edges >= 38
    assert found.share > 0.5


def test_edges_that_run_away_are_no_verticals() -> None:
    rng = np.random.default_rng(1)
    looking_down = rotation_from_vector([0.6, 0.0, 0.0])
    starts, ends = edges(rng, looking_down, np.array([0.0, 0.0, 1.0]), 60)
    found = vertical_direction(starts, ends, np.linalg.norm(ends - starts, axis=1))
    assert found is None or found.edges < 6


def test_no_edges_tell_nothing() -> None:
    none = np.zeros((0, 2))
    assert vertical_direction(none, none, np.zeros(0)) is None
    level = np.array([[0.0, 0.1 * k] for k in range(5)])
    assert vertical_direction(level, level + np.array([0.5, 0.0]), np.ones(5)) is None
    with pytest.raises(InvalidInputError):
        vertical_direction(level, level, np.ones(4))
