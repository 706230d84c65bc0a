"""Every extractor: the same picture gives the same features, at the place where they are in the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from app.errors import InvalidInputError
from app.vision.features import LocalFeatureExtractor
from app.vision.images import Gray, to_gray
from app.vision.local_features import FEATURE_NAMES, SIFT, RootSift, XFeat, create_extractor
from tests.scenes import CAMERA, Room, pose_at

# What shrinks its input first finds other details in a crop: it is asked on pictures that it takes as they are.
NATIVE_SIDE_PX = 320


@pytest.fixture(scope="module")
def gray(room: Room) -> Gray:
    """A picture full of corners and blobs, 320 x 240."""
    return to_gray(room.view(pose_at(1.6, 1.4, 1.4, 20.0)).rgb)


@pytest.fixture(scope="module", params=FEATURE_NAMES)
def extractor(request: pytest.FixtureRequest) -> LocalFeatureExtractor:
    """Each extractor in turn."""
    return create_extractor(request.param)


def test_a_picture_always_gives_the_same_features(extractor: LocalFeatureExtractor, gray: Gray) -> None:
    a, b = extractor.extract(gray), extractor.extract(gray.copy())
    assert len(a) > 100
    assert np.array_equal(a.keypoints_px, b.keypoints_px)
    assert np.array_equal(a.descriptors, b.descriptors)
    assert a.descriptors.shape == (len(a), extractor.descriptor_size)
    assert a.descriptors.dtype == extractor.descriptor_dtype
    assert a.keypoints_px.dtype == np.float32
    assert (a.keypoints_px >= -0.5).all()
    assert (a.keypoints_px <= [CAMERA.width - 0.5, CAMERA.height - 0.5]).all()


@pytest.mark.parametrize("shape", [(240, 320), (33, 32), (32, 640), (640, 32), (75, 1500)], ids=str)
def test_a_blank_picture_has_no_features(extractor: LocalFeatureExtractor, shape: tuple[int, int]) -> None:
    features = extractor.extract(np.full(shape, 128, np.uint8))
    assert len(features) == 0
    assert features.descriptors.shape == (0, extractor.descriptor_size)
    assert features.descriptors.dtype == extractor.descriptor_dtype


def test_a_faint_picture_is_searched_with_a_lower_contrast(gray: Gray) -> None:
    faint = np.rint(160 + 0.1 * (gray.astype(np.float32) - 128)).astype(np.uint8)
    found, plain = RootSift().extract(faint), RootSift(few_features=0).extract(faint)
    assert len(plain) < SIFT.few_features
    assert len(found) > 2 * len(plain)
    # What stands out is found in either way: such pictures match those of better light.
    distances, _ = cKDTree(found.keypoints_px).query(plain.keypoints_px)
    assert (distances < 0.01).all()


def test_a_picture_with_enough_features_is_searched_once(gray: Gray) -> None:
    found, plain = RootSift().extract(gray), RootSift(few_features=0).extract(gray)
    assert np.array_equal(found.keypoints_px, plain.keypoints_px)


def test_a_strip_is_no_problem(extractor: LocalFeatureExtractor) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (75, 1500), dtype=np.uint8)
    features = extractor.extract(noise)
    assert (features.keypoints_px <= [1500, 75]).all()


def offsets_to_nearest(a: np.ndarray, b: np.ndarray, limit_px: float) -> np.ndarray:
    """Return the offsets (n, 2) from points of `a` to their nearest of `b`, of those within the limit."""
    distances, rows = cKDTree(b).query(a)
    return np.asarray((b[rows] - a)[distances < limit_px])


@pytest.mark.parametrize("name", FEATURE_NAMES)
def test_a_crop_moves_the_features_by_just_its_corner(gray: Gray, name: str) -> None:
    extractor = create_extractor(name)
    # A multiple of the cells that XFeat's network works on; to the others it is as good as any.
    dx, dy = 32, 32
    whole = extractor.extract(gray).keypoints_px
    cropped = extractor.extract(np.ascontiguousarray(gray[dy:, dx:])).keypoints_px
    inner = (whole > [dx + 24, dy + 24]).all(axis=1)
    offsets = offsets_to_nearest(whole[inner] - [dx, dy], cropped, 1.5)
    assert len(offsets) > 0.5 * inner.sum()
    assert np.abs(np.median(offsets, axis=0)).max() < 0.05
    assert np.median(np.linalg.norm(offsets, axis=1)) < 0.6


@pytest.mark.parametrize("name", FEATURE_NAMES)
def test_an_enlarged_picture_has_its_features_at_the_enlarged_places(gray: Gray, name: str) -> None:
    extractor = create_extractor(name)
    factor = 3
    large = cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    expected = (extractor.extract(gray).keypoints_px + 0.5) * factor - 0.5
    found = extractor.extract(np.asarray(large, np.uint8)).keypoints_px
    offsets = offsets_to_nearest(expected, found, 1.5 * factor)
    assert len(offsets) > 0.2 * len(expected)
    # Centres of pixels on integers: were it corners, all would be off by (factor - 1) / 2 = 1.
    assert np.abs(offsets.mean(axis=0)).max() < 0.5


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="sift"):
        create_extractor("brief")


def test_xfeat_describes_every_cell_of_a_picture() -> None:
    # A size that is reduced and cropped.
    picture = cv2.resize(to_gray(Room(3).view(pose_at(1.0, 1.3)).rgb), (850, 610))
    features, dense = XFeat().extract_dense(np.asarray(picture, np.uint8))
    pixels = features.keypoints_px.astype(np.float64)
    similar = np.einsum("nd,nd->n", features.descriptors, dense.at(pixels))
    assert np.quantile(similar, 0.1) > 0.95
    assert np.median(np.einsum("nd,nd->n", features.descriptors, dense.at(pixels + 80.0))) < 0.8
    others = dense.sample(50)
    assert others.shape == (50, 64)
    assert np.allclose(np.linalg.norm(others, axis=1), 1.0, atol=1e-5)
    assert dense.contains(
        np.array([[425.0, 300.0], [1.0, 300.0], [849.0, 300.0], [425.0, 609.0]])
    ).tolist() == [
        True,
        False,
        False,
        False,
    ]
