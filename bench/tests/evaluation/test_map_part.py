"""A part of a map is what a scan of that part would have given."""

from __future__ import annotations

import numpy as np

from app.engine.maps.repetition import elsewhere
from app.vision.index import GlobalIndex
from app.vision.local_features import create_extractor
from bench.evaluation.map_part import part_of_map
from tests.maps import map_of
from tests.scenes import pose_at

COUNT = 200


def test_what_only_the_rest_repeats_is_not_repeated() -> None:
    rng = np.random.default_rng(0)
    poses = [pose_at(0.0, 0.0), pose_at(20.0, 0.0), pose_at(40.0, 0.0)]
    prints, others = rng.integers(0, 255, (2, COUNT, 128), dtype=np.uint8)
    at = rng.uniform(0.5, 1.5, (COUNT, 3))
    points = [at + pose.translation for pose in poses]
    # The first and the last place look the same.
    whole = map_of(poses, points, [prints, others, prints])
    arrays = whole.arrays
    distances, _ = elsewhere(arrays.descriptors, False, arrays.points_in_world, arrays.offsets, poses)
    assert np.all(distances[:COUNT] < 0.01)
    index = GlobalIndex.from_descriptors(np.eye(3, 8, dtype=np.float32))
    keep = np.array([0, 1], np.int64)
    part, part_index = part_of_map(whole, index, keep, create_extractor("sift"))
    assert part.metadata.keyframe_names == ("0.png", "1.png")
    assert np.all(part.arrays.distance_elsewhere > 0.2)
    assert len(part_index) == part.keyframe_count == 2
    np.testing.assert_array_equal(part.arrays.points_in_world, arrays.points_in_world[: 2 * COUNT])
    np.testing.assert_array_equal(part.arrays.descriptors[part.rows(1)], others)
    np.testing.assert_array_equal(part_index.descriptor(1), index.descriptor(1))
