"""What looks like something elsewhere by any view of it."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.surroundings import OPTIONS, MapSurroundings
from app.engine.query.matches import excluded_keyframes
from tests.maps import map_of
from tests.scenes import pose_at

COUNT = 400


@pytest.fixture(scope="module")
def artifact() -> MapArtifact:
    rng = np.random.default_rng(0)
    poses = [pose_at(float(x), 0.0) for x in range(3)]
    return map_of(
        poses,
        [rng.uniform(-0.5, 0.5, (COUNT, 3)) for _ in poses],
        [rng.integers(0, 255, (COUNT, 8), dtype=np.uint8) for _ in poses],
        [rng.uniform(0, 1, COUNT) for _ in poses],
        [rng.integers(-1, 3, COUNT).astype(np.int32) for _ in poses],
    )


@pytest.mark.parametrize("allowed", [None, np.array([0, 1])], ids=["all", "some"])
def test_the_least_distance_around_each_point_is_found(
    artifact: MapArtifact, allowed: np.ndarray | None
) -> None:
    arrays = artifact.arrays
    counts = np.ones(len(arrays.points_in_world), bool)
    if allowed is not None:
        owner = np.repeat(np.arange(3), COUNT)
        counts = np.isin(owner, allowed) & np.isin(arrays.keyframe_elsewhere, [-1, *allowed])
    asked = np.random.default_rng(1).uniform(-0.6, 0.6, (100, 3))
    apart = np.linalg.norm(asked[:, None] - arrays.points_in_world[None], axis=2)
    near = (apart <= OPTIONS.radius_m) & counts
    wanted = np.where(near, arrays.distance_elsewhere.astype(np.float32), np.inf).min(axis=1)
    found = MapSurroundings(artifact).distance_elsewhere(asked, excluded_keyframes(artifact, allowed))
    assert np.isinf(wanted).any()
    assert np.isfinite(wanted).any()
    np.testing.assert_array_equal(found, wanted)


def test_no_points_are_asked_for(artifact: MapArtifact) -> None:
    assert MapSurroundings(artifact).distance_elsewhere(np.zeros((0, 3))).shape == (0,)
