"""Distances from points to segments."""

from __future__ import annotations

import numpy as np
import pytest

from app.geometry.triangulation import distances_to_segments


@pytest.mark.parametrize(
    ("point", "expected"),
    [((0.5, 2.0, 0.0), 2.0), ((-3.0, 4.0, 0.0), 5.0), ((4.0, 0.0, 4.0), 5.0), ((0.25, 0.0, 0.0), 0.0)],
)
def test_beside_a_segment_and_beyond_its_ends(point: tuple[float, ...], expected: float) -> None:
    first, last = np.zeros(3, np.float32), np.array([1.0, 0, 0], np.float32)
    assert distances_to_segments(np.array(point, np.float32), first, last) == pytest.approx(expected)
    assert distances_to_segments(np.array(point, np.float32), last, first) == pytest.approx(expected)


def test_a_segment_of_no_length_is_a_point() -> None:
    at = np.array([[1.0, 1.0, 1.0]], np.float32)
    assert distances_to_segments(np.zeros((1, 3), np.float32), at, at) == pytest.approx(np.sqrt(3.0))
