"""Methods of local features by name: ORB, RootSIFT, A-KAZE, XFeat, and SURF where its library is."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.vision.features import Descriptors, LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, shrink
from app.vision.onnx_session import open_session
from app.vision.xfeat import decode

MODELS_DIR = Path(__file__).parent.parent / "models"

# RootSIFT numbers are square roots of shares, nearly all below 0.5: one byte keeps them to 0.2 %.
ROOT_SIFT_SCALE = 512.0
SIFT_FEATURES, SIFT_SIDE_PX, SIFT_CONTRAST = 2000, 400, 0.04
# For a picture that is looked at once: a wide lens shows at 1280 pixels what a phone's shows at 640.
FINE_FEATURES, FINE_SIDE_PX = 8000, 1280
FAINT_SIDE_PX = 300
ORB_FEATURES = {"orb": 1000, "orb-2000": 2000}
# Binary features work on images of at most this size.
MAX_SIDE_PX = 960
# Those of anchors on larger ones: what a ceiling camera sees of a hall is small in its picture.
FULL_SIDE_PX = 1280


class RootSift:
    """SIFT with Hellinger-normalised descriptors, quantised to bytes.

    `max_side_px` is the size at which it works. OpenCV's SIFT doubles its input first, so that 400 px is a
    first octave of 800 px: as many useful keypoints as the full 640 px at two fifths of the time
    (measured: docs/features.md).
    """

    binary = False
    ratio = 0.85
    min_inliers = 12
    descriptor_size = 128
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.uint8

    def __init__(
        self,
        max_features: int = SIFT_FEATURES,
        max_side_px: int = SIFT_SIDE_PX,
        name: str = "sift",
        contrast: float = SIFT_CONTRAST,
    ) -> None:
        self.name = name
        self._contrast = contrast
        self._max_side_px = max_side_px
        self._max_features = max_features

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        small, scale = shrink(gray, self._max_side_px)
        # A detector object is not safe to share between threads, and costs nothing to make.
        sift = cv2.SIFT.create(self._max_features, contrastThreshold=self._contrast)
        keypoints, descriptors = sift.detectAndCompute(small, None)
        if not len(keypoints):
            return _none(self)
        sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
        rooted = np.sqrt(descriptors / sums) * ROOT_SIFT_SCALE
        quantised = np.minimum(np.rint(rooted), 255).astype(np.uint8)
        return LocalFeatures(_points(keypoints, scale), quantised)

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return the same at a coarser scale, down to half the contrast."""
        if self._contrast < SIFT_CONTRAST:
            return None
        return RootSift(self._max_features, FAINT_SIDE_PX, self.name, 0.5 * SIFT_CONTRAST)


class Orb:
    """ORB: 256-bit descriptors of oriented FAST corners (the RGB-D paper's features)."""

    binary = True
    ratio = 0.85
    min_inliers = 40
    descriptor_size = 32
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.uint8

    def __init__(self, max_features: int = 1000, name: str = "orb") -> None:
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
    ratio = 0.85
    min_inliers = 16
    descriptor_size = 61
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.uint8

    def __init__(
        self, max_side_px: int = MAX_SIDE_PX, max_features: int | None = None, name: str = "akaze"
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
    """XFeat's learned 64-number descriptors by ONNX Runtime; wants upright images."""

    binary = False
    ratio = 1.0
    min_inliers = 100
    descriptor_size = 64
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.float32

    def __init__(
        self, max_features: int = 1000, max_side_px: int = 640, threads: int = 1, name: str = "xfeat"
    ) -> None:
        self.name = name
        self._session = open_session(MODELS_DIR / "xfeat.onnx", threads)
        self._max_features = max_features
        self._max_side_px = max_side_px

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        small, scale = shrink(gray, self._max_side_px)
        # The network takes multiples of 32: crop the remainder rather than stretch the picture.
        height, width = (max(32, side // 32 * 32) for side in small.shape)
        image = small[:height, :width].astype(np.float32)[None, None] / 255.0
        outputs = self._session.run(["features", "keypoints", "reliability"], {"image": image})
        keypoints_px, _, descriptors = decode(outputs[0], outputs[1], outputs[2], self._max_features)
        return LocalFeatures(((keypoints_px + 0.5) / scale - 0.5).astype(np.float32), descriptors)

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return None."""
        return None


def create_extractor(name: str, threads: int = 1) -> LocalFeatureExtractor:
    """Return the extractor that a map or a request names; raises `InvalidInputError` for an unknown name."""
    if name == "sift":
        return RootSift()
    if name == "sift-full":
        return RootSift(max_side_px=960, name=name)
    if name in ORB_FEATURES:
        return Orb(ORB_FEATURES[name], name)
    if name == "akaze":
        return Akaze()
    if name == "xfeat":
        return XFeat(threads=threads)
    if check_features(name) == "surf":
        # It is an extra, and builds on the types above.
        from app.vision.surf import Surf

        return Surf()
    raise InvalidInputError(f"Features {name!r} are not known; use one of {', '.join(FEATURE_NAMES)}.")


def create_fine_extractor(name: str) -> LocalFeatureExtractor:
    """Return an extractor of the same descriptors that takes its time: more features, found in a larger picture."""
    if name in ("sift", "sift-full"):
        return RootSift(FINE_FEATURES, FINE_SIDE_PX, name, 0.5 * SIFT_CONTRAST)
    if name == "akaze":
        return Akaze(FULL_SIDE_PX, FINE_FEATURES)
    return XFeat(FINE_FEATURES // 2, FINE_SIDE_PX) if name == "xfeat" else create_extractor(name)


FEATURE_NAMES = ("sift", "sift-full", "orb", "orb-2000", "akaze", "xfeat", "surf")


def check_features(name: str) -> str:
    """Return the name of features that can be computed here; raises `InvalidInputError` when a library is missing."""
    if name == "surf" and find_spec("mahotas") is None:
        raise InvalidInputError(
            "Features 'surf' need the library mahotas, which is not installed: install roomfix[surf], or use sift."
        )
    return name


def _binary_features(
    detector: cv2.Feature2D, gray: Gray, extractor: LocalFeatureExtractor, max_side_px: int = MAX_SIDE_PX
) -> LocalFeatures:
    small, scale = shrink(gray, max_side_px)
    keypoints, descriptors = detector.detectAndCompute(small, None)
    if not len(keypoints):
        return _none(extractor)
    return LocalFeatures(_points(keypoints, scale), np.asarray(descriptors, dtype=np.uint8))


def _points(keypoints: Sequence[cv2.KeyPoint], scale: float) -> NDArray[np.float32]:
    points = np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float32)
    return np.asarray((points + 0.5) / scale - 0.5, dtype=np.float32)


def _none(extractor: LocalFeatureExtractor) -> LocalFeatures:
    shape = (0, extractor.descriptor_size)
    none: Descriptors = np.zeros(shape, np.uint8)
    if extractor.descriptor_dtype is np.float32:
        none = np.zeros(shape, np.float32)
    return LocalFeatures(np.zeros((0, 2), np.float32), none)
