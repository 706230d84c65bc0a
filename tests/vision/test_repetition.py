"""Which features of a map have a look-alike elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from app.vision import repetition
from app.vision.repetition import (
    PLACE,
    Rays,
    RepetitionOptions,
    find_repetition,
    find_repetition_on_rays,
)

COUNT = 300


def noisy_copies(rng: np.random.Generator, rows: np.ndarray) -> np.ndarray:
    return np.clip(rows + rng.normal(scale=2.0, size=rows.shape), 0, 255)


def test_what_is_repeated_elsewhere_is_near_and_what_is_not_is_far() -> None:
    rng = np.random.default_rng(0)
    prints = rng.uniform(0, 255, (COUNT, 128))
    # Each thing is seen twice where it is; the first half hangs again in another room.
    descriptors = np.concatenate([prints, noisy_copies(rng, prints), noisy_copies(rng, prints[: COUNT // 2])])
    here = rng.uniform(0, 1, (COUNT, 3))
    there = here[: COUNT // 2] + np.array([10.0, 0, 0])
    points = np.concatenate([here, here, there]).astype(np.float32)
    every = np.arange(len(points))
    found = find_repetition(descriptors.astype(np.uint8), False, points, every).distance
    rows = find_repetition(descriptors.astype(np.uint8), False, points, every).row
    assert np.mean(rows[2 * COUNT :] % COUNT == np.arange(COUNT // 2)) > 0.95
    repeated = np.r_[found[: COUNT // 2], found[2 * COUNT :]]
    single = found[COUNT // 2 : COUNT]
    assert np.percentile(repeated, 95) < 0.1
    assert np.percentile(single, 5) > 0.3


def test_the_next_floor_is_elsewhere() -> None:
    rng = np.random.default_rng(1)
    prints = rng.uniform(0, 255, (COUNT, 128))
    points = rng.uniform(0, 1, (COUNT, 3))
    twice = np.concatenate([prints, prints]).astype(np.uint8)
    above = np.concatenate([points, points + np.array([0, 0, 3.0])]).astype(np.float32)
    beside = np.concatenate([points, points + np.array([3.0, 0, 0])]).astype(np.float32)
    every = np.arange(len(twice))
    assert np.median(find_repetition(twice, False, above, every).distance) < 0.01
    assert np.median(find_repetition(twice, False, beside, every).distance) > 0.1
    # Where nobody knows which axis points up, z is an axis like the others.
    assert np.median(find_repetition(twice, False, above, every, z_up=False).distance) > 0.1
    assert PLACE.radius_m > 3.0


@pytest.mark.parametrize("count", [0, 1, 5])
def test_tiny_maps_have_nothing_elsewhere(count: int) -> None:
    rng = np.random.default_rng(2)
    descriptors = rng.integers(0, 255, (count, 32), dtype=np.uint8)
    found = find_repetition(descriptors, True, np.zeros((count, 3), np.float32), np.arange(count))
    assert found.distance.shape == found.row.shape == (count,)
    assert np.all(np.isinf(found.distance))
    assert np.all(found.row == -1)


def test_what_looks_alike_is_found_past_many_views_of_the_same_thing() -> None:
    rng = np.random.default_rng(3)
    prints = rng.uniform(0, 255, (20, 128))
    # A video's hundred frames of each thing, and one of its like in another room.
    frames = [noisy_copies(rng, prints) for _ in range(100)]
    descriptors = np.concatenate([*frames, noisy_copies(rng, prints)]).astype(np.uint8)
    points = np.zeros((len(descriptors), 3), np.float32)
    points[-20:, 0] = 10.0
    views = np.r_[:40, len(points) - 20 : len(points)].astype(np.int64)
    found = find_repetition(descriptors, False, points, views)
    assert np.all(found.row[:2000] >= len(points) - 20)


@pytest.mark.parametrize("is_binary", [False, True])
def test_chunks_of_features_change_nothing(monkeypatch: pytest.MonkeyPatch, is_binary: bool) -> None:
    rng = np.random.default_rng(4)
    descriptors = rng.integers(0, 255, (500, 32), dtype=np.uint8)
    points = rng.uniform(0, 20, (500, 3)).astype(np.float32)
    among = np.flatnonzero(rng.random(500) < 0.8)
    whole = find_repetition(descriptors, is_binary, points, among)
    monkeypatch.setattr(repetition, "OPTIONS", RepetitionOptions(chunk_features=37))
    found = find_repetition(descriptors, is_binary, points, among)
    np.testing.assert_array_equal(found.distance, whole.distance)
    np.testing.assert_array_equal(found.row, whole.row)


def rays_towards(points: np.ndarray, centre: np.ndarray, descriptors: np.ndarray, keyframe: int) -> Rays:
    ahead = points - centre
    return Rays(
        descriptors,
        np.full(len(points), keyframe),
        np.broadcast_to(centre, points.shape),
        ahead / np.linalg.norm(ahead, axis=1, keepdims=True),
    )


def test_a_feature_without_a_point_is_elsewhere_where_its_whole_ray_is() -> None:
    rng = np.random.default_rng(6)
    prints = rng.uniform(0, 255, (COUNT, 128)).astype(np.uint8)
    points = rng.uniform(0, 1, (COUNT, 3)).astype(np.float32)
    own = np.zeros(COUNT, np.int64)
    alike = np.ones((2, 2), bool)
    away, near = np.array([20.0, 0, 0]), np.array([-1.0, 0, 0])

    def rows(centre: np.ndarray, towards: np.ndarray, alike: np.ndarray) -> np.ndarray:
        rays = rays_towards(points + towards, centre, prints, 1)
        return find_repetition_on_rays(prints, False, points, own, rays, alike).row

    assert np.array_equal(rows(away, np.array([40.0, 0, 0]), alike), np.arange(COUNT))
    # On a ray that passes the points it may be one of them, and near the points it is at their place.
    assert np.all(rows(near, np.zeros(3), alike) == -1)
    assert np.all(rows(near, np.array([-30.0, 0, 0]), alike) == -1)
    # 20 m away the ray ends before it reaches them.
    assert np.array_equal(rows(away, np.zeros(3), alike), np.arange(COUNT))
    # In a keyframe that looks quite different it is only a texture.
    assert np.all(rows(away, np.array([40.0, 0, 0]), np.eye(2, dtype=bool)) == -1)
    none = rays_towards(points[:0], away, prints[:0], 1)
    found = find_repetition_on_rays(prints, False, points, own, none, alike)
    assert np.all(np.isinf(found.distance))
