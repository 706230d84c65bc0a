"""The second features of a map: kept with it, taken and joined by keyframe."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from app.engine.mapping.extend_map import join_maps
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.second_features import SecondFeatures
from app.geometry.se3 import Pose
from app.vision.index import GlobalIndex
from tests.maps import map_of


def features_of(*counts: int, seed: int = 0) -> SecondFeatures:
    """Return second features of keyframes with these counts of them."""
    rng = np.random.default_rng(seed)
    total = sum(counts)
    return SecondFeatures(
        offsets=np.cumsum([0, *counts]).astype(np.int64),
        keypoints_px=rng.uniform(0, 100, (total, 2)).astype(np.float32),
        points_in_world=rng.normal(size=(total, 3)).astype(np.float32),
        point_sigma_m=rng.uniform(0.01, 0.02, total).astype(np.float32),
        descriptors=rng.normal(size=(total, 64)).astype(np.float16),
    )


def assert_same(a: SecondFeatures, b: SecondFeatures) -> None:
    for name in SecondFeatures.__slots__:
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def map_with(second: SecondFeatures | None) -> tuple[MapArtifact, GlobalIndex]:
    """Return a map of two keyframes without features of its own kind."""
    poses = [Pose.identity(), Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))]
    rng = np.random.default_rng(1)
    points = [rng.normal(size=(5, 3)) for _ in poses]
    descriptors = [rng.integers(0, 255, (5, 128)).astype(np.uint8) for _ in poses]
    index = GlobalIndex.from_descriptors(rng.normal(size=(2, 8)).astype(np.float32))
    return replace(map_of(poses, points, descriptors), second=second), index


def test_they_are_kept_with_the_map(tmp_path: Path) -> None:
    second = features_of(3, 4)
    map_with(second)[0].write(tmp_path / "with")
    opened = MapArtifact.open(tmp_path / "with")
    assert opened.second is not None
    assert_same(opened.second, second)
    assert second.nbytes == 7 * (8 + 12 + 4 + 128) + 3 * 8
    map_with(None)[0].write(tmp_path / "without")
    assert MapArtifact.open(tmp_path / "without").second is None


def test_keyframes_are_taken_in_the_order_asked_for() -> None:
    second = features_of(3, 0, 4)
    taken = second.take([2, 0])
    assert taken.offsets.tolist() == [0, 4, 7]
    assert np.array_equal(taken.descriptors, np.r_[second.descriptors[3:], second.descriptors[:3]])
    assert_same(SecondFeatures.join([second.take([0]), second.take([1, 2])]), second)
    assert second.take([]).offsets.tolist() == [0]


def test_a_map_without_them_has_none_in_its_part_of_a_joined_map() -> None:
    second = features_of(3, 4)
    bare, both = map_with(None), map_with(second)
    assert join_maps(*bare, *bare, binary=False)[0].second is None
    joined = join_maps(*bare, *both, binary=False)[0].second
    assert joined is not None
    assert joined.offsets.tolist() == [0, 0, 0, 3, 7]
    assert_same(joined.take([2, 3]), second)
