"""Keyframes every d metres (B eq. 1) and every n-th frame."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from app.vision.sampling import select_by_distance, select_by_interval


def test_each_keyframe_is_the_first_that_is_far_enough_from_the_last() -> None:
    rng = np.random.default_rng(0)
    places = np.cumsum(rng.normal(0.05, 0.03, (200, 3)), axis=0)
    chosen = select_by_distance(places, 0.5)
    assert chosen[0] == 0
    for a, b in itertools.pairwise(chosen):
        steps = np.linalg.norm(places[a + 1 : b + 1] - places[a], axis=1)
        assert steps[-1] >= 0.5
        assert (steps[:-1] < 0.5).all()


@pytest.mark.parametrize(("every_m", "count"), [(0.5, 20), (1.0, 10), (0.05, 200), (100.0, 1)])
def test_an_even_walk_gives_even_keyframes_in_spite_of_rounding(every_m: float, count: int) -> None:
    places = np.outer(np.arange(200) * 0.05, [0.6, 0.8, 0.0])
    assert len(select_by_distance(places, every_m)) == count


def test_a_camera_that_stands_gives_one_keyframe_and_none_gives_none() -> None:
    assert select_by_distance(np.ones((30, 3)), 0.5) == [0]
    assert select_by_distance(np.zeros((0, 3)), 0.5) == []


def test_every_nth_frame() -> None:
    assert select_by_interval(range(10), 4) == [0, 4, 8]
    assert select_by_interval(range(3), 1) == [0, 1, 2]
    assert select_by_interval([], 5) == []
