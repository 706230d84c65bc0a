"""Depth beside its picture: how far it must be moved."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.examination.depth_shift import SmallPicture, measure_depth_shift


def boards(seed: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return a picture of boards before a wall, and its depth."""
    rng = np.random.default_rng(seed)
    gray = rng.normal(120, 4, (240, 320))
    depth_m = np.full((240, 320), 3.0, np.float32)
    for _ in range(12):
        x, y = rng.integers(30, 260), rng.integers(30, 180)
        w, h = rng.integers(15, 50, 2)
        gray[y : y + h, x : x + w] += rng.choice([-60, 60])
        depth_m[y : y + h, x : x + w] = rng.uniform(1.0, 2.5)
    return np.clip(gray, 0, 255).astype(np.uint8), depth_m


@pytest.mark.parametrize(("right", "down"), [(0, 0), (15, 0), (-9, 12)])
def test_the_shift_is_measured(right: int, down: int) -> None:
    pictures = [boards(seed) for seed in range(6)]
    moved = [
        SmallPicture.of(gray, np.roll(depth_m, (down, right), axis=(0, 1))) for gray, depth_m in pictures
    ]
    found = measure_depth_shift(moved)
    assert found is not None
    assert (found.right_px, found.down_px) == (pytest.approx(-right, abs=2), pytest.approx(-down, abs=2))
    assert found.peak > 5.5


def test_walls_without_edges_say_nothing() -> None:
    gray, depth_m = boards(0)
    assert measure_depth_shift([SmallPicture.of(gray, np.full_like(depth_m, 2.0))]) is None
