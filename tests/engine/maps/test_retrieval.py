"""Retrieval by place: look-alikes elsewhere are found, neighbours and unrelated keyframes are not."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.maps.artifact import MapArrays, MapArtifact, MapMetadata
from app.engine.maps.retrieval import Retrieval
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from app.vision.index import GlobalIndex

CAMERA = Camera("PINHOLE", 640, 480, (500.0, 500.0, 319.5, 239.5))
SPOTS = 8
# Two corridors and, above the first, one on the next floor: keyframes a metre apart along x, all looking along x.
ORIGINS = np.array([[0.0, 0.0, 1.5], [0.0, 20.0, 1.5], [0.0, 0.0, 5.0]])
ALONG_X = rotation_from_vector([0.0, np.pi / 2, 0.0])


@pytest.fixture
def retrieval() -> Retrieval:
    """The corridors' retrieval, with z known to point up."""
    return retrieval_of(z_up=True)


def retrieval_of(z_up: bool) -> Retrieval:
    """Three corridors of eight keyframes each whose descriptors are nearly the same at the same place along them."""
    rng = np.random.default_rng(5)
    spots = rng.normal(size=(SPOTS, 64))
    positions = np.concatenate([origin + np.outer(np.arange(SPOTS), [1.0, 0, 0]) for origin in ORIGINS])
    descriptors = np.concatenate([spots + 0.05 * rng.normal(size=spots.shape) for _ in ORIGINS])
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    count = len(positions)
    arrays = MapArrays(
        positions=positions,
        quaternions=np.tile(Pose(ALONG_X, np.zeros(3)).quaternion, (count, 1)),
        camera_rows=np.zeros(count, np.int32),
        offsets=np.zeros(count + 1, np.int64),
        keypoints_px=np.zeros((0, 2), np.float32),
        points_in_world=np.zeros((0, 3), np.float32),
        point_sigma_m=np.zeros(0, np.float32),
        distance_elsewhere=np.zeros(0, np.float16),
        keyframe_elsewhere=np.zeros(0, np.int32),
        descriptors=np.zeros((0, 128), np.uint8),
    )
    names = tuple(str(i) for i in range(count))
    artifact = MapArtifact(
        metadata=MapMetadata(
            features="sift",
            descriptor_sha256="0" * 64,
            descriptor_size=64,
            cameras=(CAMERA,),
            keyframe_names=names,
            z_up=z_up,
        ),
        arrays=arrays,
    )
    return Retrieval(artifact, GlobalIndex.from_descriptors(descriptors.astype(np.float32)))


def corridor(keyframe: int) -> int:
    return keyframe // SPOTS


def test_look_alikes_are_the_same_spot_of_the_other_corridors(retrieval: Retrieval) -> None:
    assert set(retrieval.look_alikes(3, 2)) == {3 + SPOTS, 3 + 2 * SPOTS}
    assert all(corridor(other) != 0 or abs(other - 3) >= 4 for other in retrieval.look_alikes(3, 6))


def test_what_is_above_is_another_place_only_where_up_is_known(retrieval: Retrieval) -> None:
    unknown = retrieval_of(z_up=False)
    # The next floor is 3.5 m above: within the radius of a place, unless height counts more.
    assert 3 + 2 * SPOTS in retrieval.look_alikes(3, 2)
    assert 3 + 2 * SPOTS not in unknown.look_alikes(3, 2)
    assert 3 + SPOTS in unknown.look_alikes(3, 2)


def test_other_places_are_added_to_the_nearest_keyframes(retrieval: Retrieval) -> None:
    descriptor = retrieval._index.descriptor(2)
    assert retrieval.similar(descriptor, 1, 0) == [2]
    found = retrieval.similar(descriptor, 1, 2)
    assert found[0] == 2
    assert {corridor(other) for other in found} == {0, 1, 2}


def test_covisible_keyframes_stay_in_the_corridor_and_look_the_same_way(retrieval: Retrieval) -> None:
    pose = Pose(ALONG_X, ORIGINS[1] + [2.2, 0.0, 0.0])
    found = retrieval.covisible(pose, 4, {SPOTS + 2})
    assert found[0] == SPOTS + 3
    assert SPOTS + 2 not in found
    assert all(corridor(keyframe) == 1 for keyframe in found)
    backwards = Pose(rotation_from_vector([0.0, -np.pi / 2, 0.0]), pose.translation)
    assert retrieval.covisible(backwards, 4, set()) == []


def test_a_restriction_holds(retrieval: Retrieval) -> None:
    allowed = np.arange(SPOTS, 2 * SPOTS, dtype=np.int64)
    pose = Pose(ALONG_X, ORIGINS[0])
    assert all(corridor(k) == 1 for k in retrieval.similar(retrieval._index.descriptor(0), 3, 3, allowed))
    assert retrieval.covisible(pose, 4, set(), allowed) == []
