"""Plain pipelines, as one writes them with libraries' own parts: what the service is compared with.

The same retrieval as the service's, five keyframes matched one by one, points from each keyframe's own depth, LO-RANSAC
with refinement, and no check but the number of inliers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
from app.vision.local_features import XFeat

PlainName = Literal["sift", "dense-sift", "xfeat"]
PLAIN_NAMES: tuple[PlainName, ...] = ("sift", "dense-sift", "xfeat")

SIFT_FEATURES = 2000
# COLMAP's: 8192 features, a peak threshold of 0.02 over three layers, RootSIFT, mutual nearest neighbours.
DENSE_FEATURES = 8192
DENSE_CONTRAST = 0.02
XFEAT_FEATURES = 2048
# The published XFeat matches mutual nearest neighbours of at least this cosine.
XFEAT_COSINE = 0.82
KEYFRAMES = 5
RATIO = 0.8
MAX_ERROR_PX = 6.0
MIN_INLIERS = 12

Pixels = NDArray[np.float64]
Vectors = NDArray[np.float32]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class PlainFeatures:
    """How pictures are described: pixels (n, 2) and descriptors (n, d); and which rows of two sets match."""

    extract: Callable[[Rgb], tuple[Pixels, Vectors]]
    match: Callable[[Vectors, Vectors], tuple[Rows, Rows]]


@dataclass(frozen=True, slots=True)
class _Keyframe:
    descriptors: Vectors
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
        points_px, descriptors = self._features.extract(rgb)
        rows, _ = self._index.search(self._models.global_descriptor.describe(rgb), KEYFRAMES)
        pixels, points = [np.zeros((0, 2))], [np.zeros((0, 3))]
        for row in rows:
            keyframe = self._keyframes[int(row)]
            if min(len(descriptors), len(keyframe.descriptors)) >= 2:
                a, b = self._features.match(descriptors, keyframe.descriptors)
                pixels.append(points_px[a])
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
    matcher and a ratio test; `dense-sift` as COLMAP's; `xfeat` with mutual nearest neighbours."""
    if name == "sift":
        return PlainFeatures(_sift, _ratio_matches)
    if name == "dense-sift":
        return PlainFeatures(_dense_sift, _mutual_ratio_matches)
    xfeat = XFeat(XFEAT_FEATURES)

    def extract(rgb: Rgb) -> tuple[Pixels, Vectors]:
        found = xfeat.extract(to_gray(rgb))
        return found.keypoints_px.astype(np.float64), found.descriptors.astype(np.float32)

    return PlainFeatures(extract, _mutual_cosine_matches)


def _sift(rgb: Rgb) -> tuple[Pixels, Vectors]:
    return _described(cv2.SIFT.create(SIFT_FEATURES), rgb)


def _dense_sift(rgb: Rgb) -> tuple[Pixels, Vectors]:
    sift = cv2.SIFT.create(DENSE_FEATURES, contrastThreshold=DENSE_CONTRAST)
    points_px, descriptors = _described(sift, rgb)
    return points_px, np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))


def _described(sift: cv2.SIFT, rgb: Rgb) -> tuple[Pixels, Vectors]:
    keypoints, descriptors = sift.detectAndCompute(to_gray(rgb), None)
    points = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64).reshape(-1, 2)
    return points, np.asarray(descriptors if len(points) else np.zeros((0, 128)), dtype=np.float32)


def _ratio_matches(a: Vectors, b: Vectors) -> tuple[Rows, Rows]:
    pairs = [
        (first.queryIdx, first.trainIdx)
        for first, second in cv2.BFMatcher(cv2.NORM_L2).knnMatch(a, b, k=2)
        if first.distance < RATIO * second.distance
    ]
    rows = np.array(pairs, np.intp).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _mutual_ratio_matches(a: Vectors, b: Vectors) -> tuple[Rows, Rows]:
    cosines = a @ b.T
    rows, theirs = _mutual(cosines)
    two = -np.partition(-cosines[rows], 1, axis=1)[:, :2]
    distances = np.sqrt(np.maximum(2.0 - 2.0 * two, 0.0))
    good = distances[:, 0] < RATIO * distances[:, 1]
    return rows[good], theirs[good]


def _mutual_cosine_matches(a: Vectors, b: Vectors) -> tuple[Rows, Rows]:
    cosines = a @ b.T
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
    points_px, descriptors = features.extract(rgb)
    depth_m = sample_depth(source.depth_m(frame), points_px)
    valid = depth_m > 0
    in_camera = source.camera.unproject(points_px[valid], depth_m[valid])
    return _Keyframe(descriptors[valid], world_from_camera.apply(in_camera))
