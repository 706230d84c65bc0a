"""Features that keyframes take from supporting frames: which ones, at most how many, and at which pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.supporting_frames import OPTIONS, nearest_keyframe, with_supporting_features
from app.engine.maps.points import MapPoints
from app.geometry.se3 import Pose, rotation_from_vector
from app.vision.features import LocalFeatures
from tests.scenes import CAMERA

Array = NDArray[np.float64]
ORIGIN = Pose.identity()


def points(
    pixels: Array, descriptors: NDArray[np.uint8], seen_from: Pose = ORIGIN, sigma_m: float = 0.01
) -> MapPoints:
    """Return points 2 m in front of a camera, at these pixels (n, 2) of its picture."""
    in_world = seen_from.apply(CAMERA.unproject(pixels, np.full(len(pixels), 2.0)))
    features = LocalFeatures(pixels.astype(np.float32), descriptors)
    return MapPoints(features, in_world, np.full(len(pixels), sigma_m), np.ones(len(pixels), np.intp))


def descriptors(n: int, seed: int) -> NDArray[np.uint8]:
    """Return sparse descriptors (n, 128), none of them like another."""
    rng = np.random.default_rng(seed)
    return (rng.integers(0, 200, (n, 128)) * (rng.random((n, 128)) < 0.25)).astype(np.uint8)


def grid(n: int) -> Array:
    """Return n pixels that are spread over the picture."""
    rng = np.random.default_rng(1)
    return rng.uniform([10, 10], [CAMERA.width - 10, CAMERA.height - 10], (n, 2))


def test_what_a_keyframe_has_it_does_not_take_again() -> None:
    pixels, known, new = grid(60), descriptors(40, 1), descriptors(20, 2)
    own = points(pixels[:40], known)
    beside = Pose(rotation_from_vector(np.array([0.0, 0.02, 0.0])), np.array([0.05, 0.0, 0.0]))
    # The other frame sees the same forty things a pixel off, and twenty more.
    shift = ORIGIN.apply(CAMERA.unproject(pixels + 1.0, np.full(60, 2.0)))
    other = MapPoints(
        LocalFeatures(
            CAMERA.project(beside.inverse().apply(shift)).astype(np.float32), np.concatenate([known, new])
        ),
        shift,
        np.full(60, 0.01),
        np.ones(60, np.intp),
    )
    filled = with_supporting_features(own, [other], ORIGIN, CAMERA, binary=False)
    assert len(filled.features) == 60
    assert np.array_equal(filled.features.descriptors[:40], known)
    assert {row.tobytes() for row in filled.features.descriptors[40:]} == {row.tobytes() for row in new}
    # They lie where the keyframe would see them, and their points are the other frame's.
    assert np.allclose(
        CAMERA.project(filled.points_in_world[40:]), filled.features.keypoints_px[40:], atol=1e-3
    )


def test_what_two_frames_lend_is_taken_once_from_the_one_that_knows_it_best() -> None:
    pixels, lent = grid(10), descriptors(10, 3)
    own = points(grid(2), descriptors(2, 4))
    rough, fine = points(pixels, lent, sigma_m=0.05), points(pixels, lent, sigma_m=0.01)
    filled = with_supporting_features(own, [rough, fine], ORIGIN, CAMERA, binary=False)
    assert len(filled.features) == 12
    assert (filled.sigma_m == 0.01).all()


def test_a_keyframe_takes_no_more_than_it_needs_and_nothing_outside_its_picture() -> None:
    many = points(grid(2 * OPTIONS.enough_features), descriptors(2 * OPTIONS.enough_features, 5))
    own = points(grid(3), descriptors(3, 6))
    assert (
        len(with_supporting_features(own, [many], ORIGIN, CAMERA, binary=False).features)
        == OPTIONS.enough_features
    )
    full = points(grid(OPTIONS.enough_features), descriptors(OPTIONS.enough_features, 7))
    assert with_supporting_features(full, [many], ORIGIN, CAMERA, binary=False) is full
    assert with_supporting_features(own, [], ORIGIN, CAMERA, binary=False) is own
    behind = Pose(rotation_from_vector(np.array([0.0, np.pi, 0.0])), np.zeros(3))
    unseen = points(grid(20), descriptors(20, 8), seen_from=behind)
    assert len(with_supporting_features(own, [unseen], ORIGIN, CAMERA, binary=False).features) == 3


def test_the_nearest_keyframe_looks_the_same_way() -> None:
    turned = Pose(rotation_from_vector(np.array([0.0, 1.5, 0.0])), np.zeros(3))
    beside = Pose(np.eye(3), np.array([0.4, 0.0, 0.0]))
    far = Pose(np.eye(3), np.array([9.0, 0.0, 0.0]))
    assert nearest_keyframe(ORIGIN, [turned, far, beside]) == 2
    assert nearest_keyframe(ORIGIN, [turned, far]) is None
