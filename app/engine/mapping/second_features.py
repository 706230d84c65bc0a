"""XFeat's features of a map's keyframes, for frames in which the map's own features find too little."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.maps.points import MapPoints, View, points_from_depth
from app.engine.maps.second_features import SecondFeatures
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose
from app.importers.frames import Frame, FrameSource
from app.limits import limit
from app.vision.features import LocalFeatureExtractor
from app.vision.images import to_gray


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondFeatureOptions:
    """How many second features a keyframe has."""

    max_features: int = limit(
        400,
        "Most features of XFeat that a keyframe keeps.",
        chosen="By hand: with 152 bytes each they take no more than the keyframe's own features.",
    )


OPTIONS = SecondFeatureOptions()

# The features of maps that a second look can judge: what resembles something elsewhere is judged by them.
SECOND_LOOK_FEATURES = ("sift", "sift-full")


def has_second_features(options: BuildOptions) -> bool:
    """Return whether a build keeps second features."""
    return options.second_features and options.store_images and options.features in SECOND_LOOK_FEATURES


@dataclass(frozen=True, slots=True)
class PlacedKeyframe:
    """A frame of the scan and its `world_from_camera`."""

    frame: Frame
    world_from_camera: Pose


def second_features(
    source: FrameSource,
    keyframes: Sequence[PlacedKeyframe],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> SecondFeatures:
    """Return the best of each keyframe's features that have a depth, with points by it; `camera` is the map's."""

    def described(keyframe: PlacedKeyframe) -> MapPoints:
        features = extractor.extract(to_gray(frame_rgb(source, keyframe.frame)))
        depth_m = sample_depth(source.depth_m(keyframe.frame), features.keypoints_px)
        points = points_from_depth(View(keyframe.world_from_camera, features, depth_m), camera)
        return points.take(np.arange(min(OPTIONS.max_features, len(points.features))))

    found = list(map_in_order(executor, described, keyframes, "second features", progress))
    counts = [len(points.features) for points in found]
    return SecondFeatures(
        offsets=np.cumsum([0, *counts]).astype(np.int64),
        keypoints_px=np.concatenate([points.features.keypoints_px for points in found]),
        points_in_world=np.concatenate([points.points_in_world for points in found]).astype(np.float32),
        point_sigma_m=np.concatenate([points.sigma_m for points in found]).astype(np.float32),
        descriptors=np.concatenate([points.features.descriptors for points in found]).astype(np.float16),
    )
