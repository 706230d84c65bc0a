"""Tiled maps: copies that are the real map, beside each other, and don't look alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.engine.maps.artifact import MapArtifact
from app.storage.map_files import open_index
from app.vision.index import GlobalIndex
from bench.large_maps.measure import recall
from bench.large_maps.tiling import SPACING_M, tile_map
from tests.maps import map_of
from tests.scenes import pose_at

KEYFRAMES = 6
FEATURES = 20
COPIES = 3
SIZE = 256


@pytest.fixture
def small() -> tuple[MapArtifact, GlobalIndex]:
    rng = np.random.default_rng(0)
    artifact = map_of(
        [pose_at(float(x), 0.0) for x in range(KEYFRAMES)],
        [rng.uniform(-1, 1, (FEATURES, 3)) for _ in range(KEYFRAMES)],
        [rng.integers(0, 255, (FEATURES, 32), dtype=np.uint8) for _ in range(KEYFRAMES)],
        keyframe_elsewhere=[np.full(FEATURES, keyframe - 1, np.int32) for keyframe in range(KEYFRAMES)],
    )
    described = rng.normal(size=(KEYFRAMES, SIZE)).astype(np.float32)
    described /= np.linalg.norm(described, axis=1, keepdims=True)
    return artifact, GlobalIndex.from_descriptors(described)


def test_copies_are_the_map_beside_itself(small: tuple[MapArtifact, GlobalIndex], tmp_path: Path) -> None:
    artifact, index = small
    tiled = tile_map(artifact, index, COPIES, tmp_path)
    whole = MapArtifact.open(tiled.artifact_path)
    again = open_index(whole, tiled.index_path)
    assert whole.keyframe_count == len(again) == COPIES * KEYFRAMES
    assert whole.index_checksums is not None
    assert whole.places is not None
    one, all_ = artifact.arrays, whole.arrays
    for copy in range(COPIES):
        rows = slice(copy * KEYFRAMES * FEATURES, (copy + 1) * KEYFRAMES * FEATURES)
        moved = all_.points_in_world[rows] - one.points_in_world[:]
        assert np.allclose(moved, [copy * SPACING_M, 0, 0], atol=1e-4)
        elsewhere = all_.keyframe_elsewhere[rows]
        assert np.array_equal(
            elsewhere,
            np.where(one.keyframe_elsewhere[:] < 0, -1, one.keyframe_elsewhere[:] + copy * KEYFRAMES),
        )
        # The same numbers in another order; in the first copy, in the same one.
        ours, theirs = all_.descriptors[rows], one.descriptors[:]
        assert np.array_equal(np.sort(ours, axis=1), np.sort(theirs, axis=1))
        assert np.array_equal(ours, theirs) == (copy == 0)
    described = again.descriptors
    near = described @ described.T
    for copy in range(COPIES):
        own = slice(copy * KEYFRAMES, (copy + 1) * KEYFRAMES)
        assert np.allclose(near[own, own], index.descriptors @ index.descriptors.T, atol=1e-5)
    assert np.abs(near[:KEYFRAMES, KEYFRAMES:]).max() < 0.5
    assert recall(again, described, 10) == 1.0


def test_recall_counts_what_an_index_misses(small: tuple[MapArtifact, GlobalIndex]) -> None:
    rng = np.random.default_rng(3)
    described = rng.normal(size=(50, SIZE)).astype(np.float32)
    described /= np.linalg.norm(described, axis=1, keepdims=True)
    shuffled = GlobalIndex.from_descriptors(described[rng.permutation(50)])
    assert recall(GlobalIndex.from_descriptors(described), described, 20) == 1.0
    assert recall(shuffled, described, 20) < 0.5
