"""XFeat's features of a map's keyframes, for frames in which the map's own features find too little."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.triangulated_depth import triangulated_points
from app.engine.maps.points import MapPoints, View, points_from_depth
from app.engine.maps.second_features import SecondFeatures
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose
from app.importers.frames import FrameSource
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
    max_matched: int = limit(
        800,
        "Features of a frame without depth that are matched with those of other frames, for points.",
        chosen="By hand: about half of them get a point.",
    )


OPTIONS = SecondFeatureOptions()
STAGE = "second features"

# The features of maps that a second look can judge: what resembles something elsewhere is judged by them.
SECOND_LOOK_FEATURES = ("sift", "sift-full")


def has_second_features(options: BuildOptions) -> bool:
    """Return whether a build keeps second features."""
    return options.second_features and options.store_images and options.features in SECOND_LOOK_FEATURES


def second_features(
    source: FrameSource,
    poses: Sequence[Pose],
    keyframes: Sequence[int],
    support: Sequence[int],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> SecondFeatures:
    """Return the best of each keyframe's features that have a depth, with points by it; `camera` is the map's.

    `keyframes` and `support` are rows of the source's frames, `poses` the `world_from_camera` of all. Where the scan
    has no depth, features that several of these frames see have that of their triangulated point.
    """
    if source.has_depth:
        points_of = partial(_sensed_points, source, poses, camera=camera, extractor=extractor)
        every = map_in_order(executor, points_of, keyframes, STAGE, progress)
    else:
        seen = partial(_seen, source, poses, extractor=extractor)
        rows = sorted({*keyframes, *support})
        views = dict(zip(rows, map_in_order(executor, seen, rows, STAGE, progress), strict=True))
        every = triangulated_points(views, keyframes, camera, extractor, executor, progress)
    found = [points.take(np.arange(min(OPTIONS.max_features, len(points.features)))) for points in every]
    counts = [len(points.features) for points in found]
    return SecondFeatures(
        offsets=np.cumsum([0, *counts]).astype(np.int64),
        keypoints_px=np.concatenate([points.features.keypoints_px for points in found]),
        points_in_world=np.concatenate([points.points_in_world for points in found]).astype(np.float32),
        point_sigma_m=np.concatenate([points.sigma_m for points in found]).astype(np.float32),
        descriptors=np.concatenate([points.features.descriptors for points in found]).astype(np.float16),
    )


def _sensed_points(
    source: FrameSource,
    poses: Sequence[Pose],
    row: int,
    *,
    camera: Camera,
    extractor: LocalFeatureExtractor,
) -> MapPoints:
    frame = source.frames[row]
    features = extractor.extract(to_gray(frame_rgb(source, frame)))
    depth_m = sample_depth(source.depth_m(frame), features.keypoints_px)
    return points_from_depth(View(poses[row], features, depth_m), camera)


def _seen(source: FrameSource, poses: Sequence[Pose], row: int, *, extractor: LocalFeatureExtractor) -> View:
    features = extractor.extract(to_gray(frame_rgb(source, source.frames[row])))
    best = features.take(np.arange(min(OPTIONS.max_matched, len(features))))
    return View(poses[row], best, np.zeros(len(best), np.float32))
