"""A plain SIFT pipeline, as one writes it with OpenCV's own parts: what the benchmark compares with.

Full-size SIFT of up to 2000 features, the same retrieval, five keyframes matched one by one with OpenCV's
brute-force matcher and a ratio test of 0.8, points from the keyframe's own depth, LO-RANSAC with refinement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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

FEATURES = 2000
KEYFRAMES = 5
RATIO = 0.8
MAX_ERROR_PX = 6.0
MIN_INLIERS = 12


@dataclass(frozen=True, slots=True)
class _Keyframe:
    descriptors: NDArray[np.float32]
    points_in_world: NDArray[np.float64]


class PlainSift:
    """The plain pipeline on one map."""

    def __init__(
        self, source: FrameSource, keyframes: Sequence[Frame], world_from_scan: Pose, models: VisionModels
    ) -> None:
        self._models = models
        images = [decode_image(source.color_bytes(frame)) for frame in keyframes]
        describe = models.global_descriptor.describe
        self._index = GlobalIndex.from_descriptors(np.stack([describe(image) for image in images]))
        self._keyframes = [
            _keyframe(source, frame, world_from_scan, image)
            for frame, image in zip(keyframes, images, strict=True)
        ]

    def localize(self, rgb: Rgb, camera: Camera) -> Pose | None:
        """Return the `world_from_camera` of an image, or None below 12 inliers."""
        points_px, descriptors = _extract(rgb)
        rows, _ = self._index.search(self._models.global_descriptor.describe(rgb), KEYFRAMES)
        pixels, points = [], []
        for row in rows:
            keyframe = self._keyframes[int(row)]
            for first, second in cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors, keyframe.descriptors, k=2):
                if first.distance < RATIO * second.distance:
                    pixels.append(points_px[first.queryIdx])
                    points.append(keyframe.points_in_world[first.trainIdx])
        if len(pixels) < MIN_INLIERS:
            return None
        found = estimate_pose_lo_ransac(np.array(pixels), np.array(points), camera, max_error_px=MAX_ERROR_PX)
        return (
            found.world_from_camera if found is not None and found.inlier_mask.sum() >= MIN_INLIERS else None
        )


def _extract(rgb: Rgb) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    keypoints, descriptors = cv2.SIFT.create(FEATURES).detectAndCompute(to_gray(rgb), None)
    points = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64).reshape(-1, 2)
    return points, np.asarray(descriptors if len(points) else np.zeros((0, 128)), dtype=np.float32)


def _keyframe(source: FrameSource, frame: Frame, world_from_scan: Pose, rgb: Rgb) -> _Keyframe:
    points_px, descriptors = _extract(rgb)
    depth_m = sample_depth(source.depth_m(frame), points_px)
    valid = depth_m > 0
    in_camera = source.camera.unproject(points_px[valid], depth_m[valid])
    world_from_camera = world_from_scan @ frame.scan_from_camera
    return _Keyframe(descriptors[valid], world_from_camera.apply(in_camera))
