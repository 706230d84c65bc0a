"""Extractors of local features by name: RootSIFT, ORB, A-KAZE, XFeat, and SURF where mahotas is installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.limits import limit
from app.vision.dense_descriptors import DenseDescriptors
from app.vision.features import Descriptors, LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, shrink
from app.vision.learned.xfeat import CELL_PX, decode
from app.vision.onnx_session import open_session

MODELS_DIR = Path(__file__).parent.parent / "models"

# The elements of RootSIFT are at most 1 and nearly all below 0.5: one byte is enough for them.
ROOT_SIFT_SCALE = 512.0
ORB_FEATURES = {"orb": 1000, "orb-2000": 2000}
FEATURE_NAMES = ("sift", "sift-full", "orb", "orb-2000", "akaze", "xfeat", "surf")
RATIO_CHOSEN = "By hand: the geometric checks reject the false matches that pass it."


@dataclass(frozen=True, slots=True, kw_only=True)
class SiftOptions:
    """RootSIFT, as `sift` and `sift-full`."""

    ratio: float = limit(
        0.85,
        "Largest distance of the best match over that of the second best.",
        chosen=RATIO_CHOSEN,
    )
    min_inliers: int = limit(
        12,
        "Least number of inliers of a pose.",
        chosen="`roomfix evaluate SCAN --absent OTHER_PLACES`: other places reach 8 (docs/features.md).",
    )
    max_features: int = limit(
        2000,
        "Largest number of features of a picture.",
        chosen="By hand: pictures of rooms have fewer at the default size.",
    )
    max_side_px: int = limit(
        400,
        "Length to which a picture's longer side is reduced for `sift`; OpenCV then doubles it.",
        chosen="`roomfix evaluate` and `roomfix benchmark`: most accurate and fastest of six (docs/features.md).",
    )
    full_side_px: int = limit(
        960,
        "Length to which a picture's longer side is reduced for `sift-full`.",
        chosen="By hand; `roomfix evaluate` compares it with 400 (docs/features.md).",
    )
    contrast: float = limit(
        0.04,
        "OpenCV's contrast threshold for keypoints.",
        chosen="By hand: the same as OpenCV's default.",
    )
    low_contrast: float = limit(
        0.02,
        "Contrast threshold for faint pictures and for pictures that are searched more thoroughly.",
        chosen="By hand: half the default.",
    )
    few_features: int = limit(
        200,
        "A picture for `sift` with fewer features is searched again with half the contrast threshold.",
        chosen="`roomfix evaluate-bare-rooms --building 1`: 33 of 40 pictures are located; with 0, 150 and 300 "
        "features 4, 27 and 32. Pictures of furnished rooms mostly have more.",
    )
    lowest_contrast: float = limit(
        0.01,
        "Lowest contrast threshold of a picture with few features.",
        chosen="As few_features: with half of it as many pictures are located, and maps are larger.",
    )
    faint_side_px: int = limit(
        300,
        "Length to which a faint picture's longer side is reduced.",
        chosen="By hand: at a coarser scale there is less noise.",
    )
    fine_features: int = limit(
        8000,
        "Largest number of features of a picture that is searched more thoroughly.",
        chosen="By hand: such a picture is searched once, so it may take longer.",
    )
    fine_side_px: int = limit(
        1280,
        "Length to which the longer side of a picture that is searched more thoroughly is reduced.",
        chosen="By hand: a wide lens shows as much detail at 1280 pixels as a phone's at 640.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbOptions:
    """ORB, as `orb` and `orb-2000`."""

    ratio: float = limit(
        0.85,
        "Largest distance of the best match over that of the second best.",
        chosen=RATIO_CHOSEN,
    )
    min_inliers: int = limit(
        40,
        "Least number of inliers of a pose.",
        chosen="`roomfix evaluate SCAN --absent OTHER_PLACES`: other places reach 20 (docs/features.md).",
    )
    max_side_px: int = limit(
        960,
        "Length to which a picture's longer side is reduced for binary features.",
        chosen="By hand: bounds the time.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class AkazeOptions:
    """A-KAZE."""

    ratio: float = limit(
        0.85,
        "Largest distance of the best match over that of the second best.",
        chosen=RATIO_CHOSEN,
    )
    min_inliers: int = limit(
        16,
        "Least number of inliers of a pose.",
        chosen="`roomfix evaluate SCAN --absent OTHER_PLACES`: above what other places reach (docs/features.md).",
    )
    large_side_px: int = limit(
        1280,
        "Length to which the longer side of an anchor's picture is reduced.",
        chosen="By hand: things in a hall are small in the picture of a ceiling camera.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class XFeatOptions:
    """XFeat."""

    ratio: float = limit(
        1.0,
        "Largest distance of the best match over that of the second best; 1 is no ratio test.",
        chosen="By hand: XFeat's authors match by mutual nearest neighbours.",
    )
    min_inliers: int = limit(
        100,
        "Least number of inliers of a pose.",
        chosen="`roomfix evaluate SCAN --absent OTHER_PLACES`: above what other places reach (docs/features.md).",
    )
    max_features: int = limit(
        1000,
        "Largest number of features of a picture.",
        chosen="By hand: bounds the time of matching.",
    )
    max_side_px: int = limit(
        640,
        "Length to which a picture's longer side is reduced.",
        chosen="By hand: bounds the time of the network.",
    )


SIFT = SiftOptions()
ORB = OrbOptions()
AKAZE = AkazeOptions()
XFEAT = XFeatOptions()
SIFT_FEATURES = SIFT.max_features
SIFT_SIDE_PX = SIFT.max_side_px
FULL_SIDE_PX = AKAZE.large_side_px


class RootSift:
    """SIFT with Hellinger-normalized descriptors, quantized to bytes.

    A picture with fewer than `few_features` features is searched again with lower contrast thresholds. The longer side
    of a picture is reduced to `max_side_px`. OpenCV's SIFT doubles its input first, so 400 px give a
    first octave of 800 px.
    """

    binary = False
    ratio = SIFT.ratio
    min_inliers = SIFT.min_inliers
    descriptor_size = 128
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.uint8

    def __init__(
        self,
        max_features: int = SIFT.max_features,
        max_side_px: int = SIFT.max_side_px,
        name: str = "sift",
        contrast: float = SIFT.contrast,
        few_features: int = SIFT.few_features,
    ) -> None:
        self.name = name
        self._few_features = few_features
        self._contrast = contrast
        self._max_side_px = max_side_px
        self._max_features = max_features

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        small, scale = shrink(gray, self._max_side_px)
        contrast = self._contrast
        keypoints, descriptors = self._detect(small, contrast)
        # White walls show little, and what they show is faint.
        while len(keypoints) < self._few_features and contrast > SIFT.lowest_contrast:
            contrast /= 2
            keypoints, descriptors = self._detect(small, contrast)
        if not len(keypoints):
            return _no_features(self)
        sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
        rooted = np.sqrt(descriptors / sums) * ROOT_SIFT_SCALE
        quantised = np.minimum(np.rint(rooted), 255).astype(np.uint8)
        return LocalFeatures.of_shrunk(cv2.KeyPoint.convert(keypoints), scale, quantised)

    def _detect(self, small: Gray, contrast: float) -> tuple[Sequence[cv2.KeyPoint], NDArray[np.float32]]:
        # A detector object must not be shared between threads; making one takes no time.
        sift = cv2.SIFT.create(self._max_features, contrastThreshold=contrast)
        keypoints, descriptors = sift.detectAndCompute(small, None)
        return keypoints, np.asarray(descriptors, dtype=np.float32)

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return RootSIFT at a coarser scale with a lower contrast threshold, None if this one has that already."""
        if self._contrast < SIFT.contrast:
            return None
        return RootSift(self._max_features, SIFT.faint_side_px, self.name, SIFT.low_contrast)


class Orb:
    """ORB: 256-bit descriptors of oriented FAST corners (the RGB-D paper's features)."""

    binary = True
    ratio = ORB.ratio
    min_inliers = ORB.min_inliers
    descriptor_size = 32
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.uint8

    def __init__(self, max_features: int = ORB_FEATURES["orb"], name: str = "orb") -> None:
        self.name = name
        self._max_features = max_features

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        return _binary_features(cv2.ORB.create(self._max_features), gray, self)

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return None."""
        return None


class Akaze:
    """A-KAZE with its 486-bit M-LDB descriptors (the monitoring-camera thesis's features)."""

    binary = True
    ratio = AKAZE.ratio
    min_inliers = AKAZE.min_inliers
    descriptor_size = 61
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.uint8

    def __init__(
        self, max_side_px: int = ORB.max_side_px, max_features: int | None = None, name: str = "akaze"
    ) -> None:
        self.name = name
        self._max_side_px = max_side_px
        self._max_features = -1 if max_features is None else max_features

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        detector = cv2.AKAZE.create(max_points=self._max_features)
        return _binary_features(detector, gray, self, self._max_side_px)

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return None."""
        return None


class XFeat:
    """XFeat's learned descriptors of 64 numbers, by ONNX Runtime; for upright images."""

    binary = False
    ratio = XFEAT.ratio
    min_inliers = XFEAT.min_inliers
    descriptor_size = 64
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.float32

    def __init__(
        self,
        max_features: int = XFEAT.max_features,
        max_side_px: int = XFEAT.max_side_px,
        threads: int = 1,
        name: str = "xfeat",
    ) -> None:
        self.name = name
        self._session = open_session(MODELS_DIR / "xfeat.onnx", threads)
        self._max_features = max_features
        self._max_side_px = max_side_px

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        return self.extract_dense(gray)[0]

    def extract_dense(self, gray: Gray) -> tuple[LocalFeatures, DenseDescriptors]:
        """Return the features of a grey image (height, width), and the descriptors of all its places."""
        small, scale = shrink(gray, self._max_side_px)
        # The network takes multiples of 32: the remainder is cropped, because stretching would distort the picture.
        height, width = (max(32, side // 32 * 32) for side in small.shape)
        image = small[:height, :width].astype(np.float32)[None, None] / 255.0
        outputs = self._session.run(["features", "keypoints", "reliability"], {"image": image})
        keypoints_px, _, descriptors = decode(outputs[0], outputs[1], outputs[2], self._max_features)
        features = LocalFeatures(((keypoints_px + 0.5) / scale - 0.5).astype(np.float32), descriptors)
        offset = 0.5 * scale - 0.5
        input_from_image = np.array([[scale, 0.0, offset], [0.0, scale, offset]])
        return features, DenseDescriptors(np.moveaxis(outputs[0][0], 0, -1), input_from_image, CELL_PX)

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return None."""
        return None


def create_extractor(name: str, threads: int = 1) -> LocalFeatureExtractor:
    """Return the extractor that a map or a request names; raises `InvalidInputError` for an unknown name."""
    if name == "sift":
        return RootSift()
    if name == "sift-full":
        return RootSift(max_side_px=SIFT.full_side_px, name=name, few_features=0)
    if name in ORB_FEATURES:
        return Orb(ORB_FEATURES[name], name)
    if name == "akaze":
        return Akaze()
    if name == "xfeat":
        return XFeat(threads=threads)
    if check_features(name) == "surf":
        # Its library is optional.
        from app.vision.surf import Surf

        return Surf()
    raise InvalidInputError(f"Features {name!r} are not known; use one of {', '.join(FEATURE_NAMES)}.")


def create_wall_extractor() -> LocalFeatureExtractor:
    """Return what finds features as `sift-full` does, and the faint ones of plain walls too."""
    return RootSift(
        max_side_px=SIFT.full_side_px, name="sift-full", contrast=SIFT.lowest_contrast, few_features=0
    )


def create_fine_extractor(name: str) -> LocalFeatureExtractor:
    """Return a slower extractor of the same descriptors, which finds more features in a larger picture."""
    if name in ("sift", "sift-full"):
        return RootSift(SIFT.fine_features, SIFT.fine_side_px, name, SIFT.low_contrast)
    if name == "akaze":
        return Akaze(AKAZE.large_side_px, SIFT.fine_features)
    if name == "xfeat":
        return XFeat(SIFT.fine_features // 2, SIFT.fine_side_px)
    return create_extractor(name)


def check_features(name: str) -> str:
    """Return the name of features; raises `InvalidInputError` when the library that computes them is missing."""
    if name == "surf" and find_spec("mahotas") is None:
        raise InvalidInputError(
            "Features 'surf' need the library mahotas, which is not installed: install roomfix[surf], or use sift."
        )
    return name


def _binary_features(
    detector: cv2.Feature2D, gray: Gray, extractor: LocalFeatureExtractor, max_side_px: int = ORB.max_side_px
) -> LocalFeatures:
    small, scale = shrink(gray, max_side_px)
    keypoints, descriptors = detector.detectAndCompute(small, None)
    if not len(keypoints):
        return _no_features(extractor)
    points_px = cv2.KeyPoint.convert(keypoints)
    return LocalFeatures.of_shrunk(points_px, scale, np.asarray(descriptors, dtype=np.uint8))


def _no_features(extractor: LocalFeatureExtractor) -> LocalFeatures:
    shape = (0, extractor.descriptor_size)
    none: Descriptors = np.zeros(shape, np.uint8)
    if extractor.descriptor_dtype is np.float32:
        none = np.zeros(shape, np.float32)
    return LocalFeatures(np.zeros((0, 2), np.float32), none)
