"""Points of a map that are drawn: one a voxel, whatever the size of the chunks they are read in."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.drawing import points
from app.engine.maps.drawing.points import OPTIONS, DrawnPointOptions, drawn_points, thinned_rows
from tests.maps import map_of
from tests.scenes import pose_at

KEYFRAMES = 4


def room_of(features: int) -> MapArtifact:
    """A map of points on the walls of a room of 6 m, each keyframe with a fourth of them."""
    rng = np.random.default_rng(features)
    walls = rng.uniform(0, 6, (KEYFRAMES, features // KEYFRAMES, 3)).astype(np.float32)
    walls[..., 0] = np.round(walls[..., 0] / 6) * 6
    walls[0, :1] = np.nan
    made = map_of(
        [pose_at(float(x), 0.0) for x in range(KEYFRAMES)],
        list(walls),
        [np.zeros((len(each), 8), np.uint8) for each in walls],
        [np.ones(len(each)) for each in walls],
        [np.full(len(each), -1, np.int32) for each in walls],
    )
    pixels = rng.uniform(0, 480, (made.feature_count, 2)).astype(np.float32)
    return replace(made, arrays=replace(made.arrays, keypoints_px=pixels))


def plainly_thinned(artifact: MapArtifact, max_points: int) -> np.ndarray:
    """The same by all points at once."""
    points_in_world = np.asarray(artifact.arrays.points_in_world).astype(np.float64)
    rows = np.flatnonzero(
        (artifact.arrays.point_sigma_m <= OPTIONS.max_sigma_m) & np.isfinite(points_in_world).all(axis=1)
    )
    voxel_m = OPTIONS.first_voxel_m
    while True:
        offsets = points_in_world[rows] - points_in_world[rows].min(axis=0)
        _, first = np.unique(np.floor(offsets / voxel_m), axis=0, return_index=True)
        if len(first) <= max_points:
            return rows[np.sort(first)]
        voxel_m *= 2.0 if len(first) > OPTIONS.coarse_ratio * max_points else 1.25


@pytest.mark.parametrize("max_points", [1, 40, 300, 5000])
def test_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch, max_points: int) -> None:
    artifact = room_of(2000)
    monkeypatch.setattr(points, "OPTIONS", DrawnPointOptions(chunk_features=17))
    np.testing.assert_array_equal(thinned_rows(artifact, max_points), plainly_thinned(artifact, max_points))


def test_a_map_without_points_draws_nothing() -> None:
    assert len(thinned_rows(room_of(KEYFRAMES), 10)) == KEYFRAMES - 1
    assert thinned_rows(room_of(0), 10).shape == (0,)


def test_memory_does_not_grow_with_the_map() -> None:
    artifact = room_of(400_000)
    tracemalloc.start()
    try:
        assert 500 < len(thinned_rows(artifact, 1000)) <= 1000
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A hundred bytes a feature would be 40 MB.
    assert peak < 16e6


def test_each_point_has_the_colour_of_its_own_picture() -> None:
    artifact = room_of(400)
    rows = np.array([3, 4, 150, 399])
    drawn = drawn_points(
        artifact, rows, lambda keyframe: None if keyframe == 1 else np.full((480, 640, 3), keyframe, np.uint8)
    )
    assert drawn.rgb[:, 0].tolist() == [0, 0, points.UNKNOWN_RGB, 3]
    np.testing.assert_array_equal(drawn.points_in_world, artifact.arrays.points_in_world[rows])
