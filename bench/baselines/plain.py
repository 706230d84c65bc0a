"""Plain pipelines, as one writes them with libraries' own parts: what the service is compared with.

The same retrieval as the service's, five keyframes matched one by one, points from each keyframe's own depth, LO-RANSAC
with refinement, and no check but the number of inliers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.maps.vision_models import VisionModels
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.importers.frames import Frame, FrameSource
from app.vision.images import Rgb, decode_image, to_gray
from app.vision.index import GlobalIndex
from app.vision.learned.lighterglue import LighterGlue, PictureFeatures
from app.vision.local_features import XFeat

PlainName = Literal["sift", "dense-sift", "xfeat", "xfeat-lighterglue"]
PLAIN_NAMES: tuple[PlainName, ...] = ("sift", "dense-sift", "xfeat", "xfeat-lighterglue")

SIFT_FEATURES = 2000
# COLMAP's: 8192 features, a peak threshold of 0.02 over three layers, RootSIFT, mutual nearest neighbours.
DENSE_FEATURES = 8192
DENSE_CONTRAST = 0.02
XFEAT_FEATURES = 2048
# The published XFeat matches mutual nearest neighbours of at least this cosine.
XFEAT_COSINE = 0.82
# LighterGlue's time grows with the square of this number.
LIGHTERGLUE_FEATURES = 1024
KEYFRAMES = 5
RATIO = 0.8
MAX_ERROR_PX = 6.0
MIN_INLIERS = 12

Pixels = NDArray[np.float64]
Vectors = NDArray[np.float32]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Described:
    """A picture's features: pixels (n, 2), descriptors (n, d), and the picture's width and height."""

    points_px: Pixels
    descriptors: Vectors
    size_px: tuple[int, int]

    def __len__(self) -> int:
        return len(self.points_px)

    def take(self, chosen: NDArray[np.bool_]) -> Described:
        """Return the features that a mask (n,) marks."""
        return Described(self.points_px[chosen], self.descriptors[chosen], self.size_px)


@dataclass(frozen=True, slots=True)
class PlainFeatures:
    """How pictures are described, and which rows of two pictures' features match."""

    extract: Callable[[Rgb], Described]
    match: Callable[[Described, Described], tuple[Rows, Rows]]


@dataclass(frozen=True, slots=True)
class _Keyframe:
    described: Described
    points_in_world: Pixels


class PlainPipeline:
    """A plain pipeline on one map."""

    def __init__(
        self,
        name: PlainName,
        source: FrameSource,
        keyframes: Sequence[Frame],
        world_from_scan: Pose,
        models: VisionModels,
    ) -> None:
        self._models = models
        self._features = plain_features(name)
        images = [decode_image(source.color_bytes(frame)) for frame in keyframes]
        describe = models.global_descriptor.describe
        self._index = GlobalIndex.from_descriptors(np.stack([describe(image) for image in images]))
        self._keyframes = [
            _keyframe(self._features, source, world_from_scan @ frame.scan_from_camera, frame, image)
            for frame, image in zip(keyframes, images, strict=True)
        ]

    def localize(self, rgb: Rgb, camera: Camera) -> Pose | None:
        """Return the `world_from_camera` of an image, or None below 12 inliers."""
        own = self._features.extract(rgb)
        rows, _ = self._index.search(self._models.global_descriptor.describe(rgb), KEYFRAMES)
        pixels, points = [np.zeros((0, 2))], [np.zeros((0, 3))]
        for row in rows:
            keyframe = self._keyframes[int(row)]
            if min(len(own), len(keyframe.described)) >= 2:
                a, b = self._features.match(own, keyframe.described)
                pixels.append(own.points_px[a])
                points.append(keyframe.points_in_world[b])
        matched_px = np.concatenate(pixels)
        if len(matched_px) < MIN_INLIERS:
            return None
        found = estimate_pose_lo_ransac(matched_px, np.concatenate(points), camera, max_error_px=MAX_ERROR_PX)
        return (
            found.world_from_camera if found is not None and found.inlier_mask.sum() >= MIN_INLIERS else None
        )


def plain_features(name: PlainName) -> PlainFeatures:
    """Return the features and the matching of a plain pipeline: full-size SIFT of up to 2000 features with OpenCV's
    matcher and a ratio test; `dense-sift` as COLMAP's; `xfeat` with mutual nearest neighbours; `xfeat-lighterglue`
    with the network."""
    if name == "sift":
        return PlainFeatures(_sift, _ratio_matches)
    if name == "dense-sift":
        return PlainFeatures(_dense_sift, _mutual_ratio_matches)
    if name == "xfeat":
        return PlainFeatures(partial(_xfeat, XFeat(XFEAT_FEATURES)), _mutual_cosine_matches)
    network = LighterGlue()

    def network_matches(a: Described, b: Described) -> tuple[Rows, Rows]:
        return network.match(_for_network(a), _for_network(b))[:2]

    return PlainFeatures(partial(_xfeat, XFeat(LIGHTERGLUE_FEATURES)), network_matches)


def _sift(rgb: Rgb) -> Described:
    return _described(cv2.SIFT.create(SIFT_FEATURES), rgb)


def _dense_sift(rgb: Rgb) -> Described:
    found = _described(cv2.SIFT.create(DENSE_FEATURES, contrastThreshold=DENSE_CONTRAST), rgb)
    sums = np.maximum(found.descriptors.sum(axis=1, keepdims=True), 1e-9)
    return Described(found.points_px, np.sqrt(found.descriptors / sums), found.size_px)


def _xfeat(extractor: XFeat, rgb: Rgb) -> Described:
    found = extractor.extract(to_gray(rgb))
    descriptors = found.descriptors.astype(np.float32)
    return Described(found.keypoints_px.astype(np.float64), descriptors, _size_px(rgb))


def _described(sift: cv2.SIFT, rgb: Rgb) -> Described:
    keypoints, descriptors = sift.detectAndCompute(to_gray(rgb), None)
    points = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64).reshape(-1, 2)
    found = np.asarray(descriptors if len(points) else np.zeros((0, 128)), dtype=np.float32)
    return Described(points, found, _size_px(rgb))


def _size_px(rgb: Rgb) -> tuple[int, int]:
    return rgb.shape[1], rgb.shape[0]


def _for_network(found: Described) -> PictureFeatures:
    return PictureFeatures(found.points_px.astype(np.float32), found.descriptors, found.size_px)


def _ratio_matches(a: Described, b: Described) -> tuple[Rows, Rows]:
    pairs = [
        (first.queryIdx, first.trainIdx)
        for first, second in cv2.BFMatcher(cv2.NORM_L2).knnMatch(a.descriptors, b.descriptors, k=2)
        if first.distance < RATIO * second.distance
    ]
    rows = np.array(pairs, np.intp).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _mutual_ratio_matches(a: Described, b: Described) -> tuple[Rows, Rows]:
    cosines = a.descriptors @ b.descriptors.T
    rows, theirs = _mutual(cosines)
    two = -np.partition(-cosines[rows], 1, axis=1)[:, :2]
    distances = np.sqrt(np.maximum(2.0 - 2.0 * two, 0.0))
    good = distances[:, 0] < RATIO * distances[:, 1]
    return rows[good], theirs[good]


def _mutual_cosine_matches(a: Described, b: Described) -> tuple[Rows, Rows]:
    cosines = a.descriptors @ b.descriptors.T
    rows, theirs = _mutual(cosines)
    good = cosines[rows, theirs] > XFEAT_COSINE
    return rows[good], theirs[good]


def _mutual(cosines: Vectors) -> tuple[Rows, Rows]:
    best = cosines.argmax(axis=1)
    rows = np.flatnonzero(cosines.argmax(axis=0)[best] == np.arange(len(cosines)))
    return rows, best[rows]


def _keyframe(
    features: PlainFeatures, source: FrameSource, world_from_camera: Pose, frame: Frame, rgb: Rgb
) -> _Keyframe:
    found = features.extract(rgb)
    depth_m = sample_depth(source.depth_m(frame), found.points_px)
    valid = depth_m > 0
    in_camera = source.camera.unproject(found.points_px[valid], depth_m[valid])
    return _Keyframe(found.take(valid), world_from_camera.apply(in_camera))
