"""The keyframes of a scan by the rule that the options name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor

import numpy as np

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.keyframe_rule import KeyframeRule
from app.engine.progress import Progress, map_in_order
from app.geometry.se3 import Pose
from app.importers.frames import FrameSource
from app.vision.content_keyframes import ContentSelector, FrameContent
from app.vision.features import LocalFeatureExtractor
from app.vision.images import measure_quality, to_gray
from app.vision.keyframes import select_by_pose
from app.vision.sampling import select_by_distance, select_by_interval


def select_keyframes(
    source: FrameSource,
    poses: Sequence[Pose],
    rule: KeyframeRule,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> list[int]:
    """Return the rows of the frames that become keyframes; `poses` are the frames' `world_from_camera`.

    The content rule describes every frame, reported as the stage `compare`; the others need the poses only.
    """
    if rule.rule == "interval":
        return select_by_interval(poses, rule.every)
    if rule.rule == "distance":
        return select_by_distance(np.stack([pose.translation for pose in poses]), rule.every_m)
    if rule.rule == "content":
        selector = ContentSelector(rule.content, extractor.ratio, extractor.binary)
        return selector.select(frame_contents(source, poses, extractor, executor, progress))
    return select_by_pose(poses, rule.thresholds)


def frame_contents(
    source: FrameSource,
    poses: Sequence[Pose],
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> Iterator[FrameContent]:
    """Yield descriptors and quality of the frames, for the content rule; only a few frames are in memory at a time."""

    def describe(row: int) -> FrameContent:
        gray = to_gray(frame_rgb(source, source.frames[row]))
        quality = measure_quality(gray)
        descriptors = extractor.extract(gray).descriptors
        return FrameContent(descriptors, quality.sharpness, quality.is_poor, poses[row])

    return map_in_order(executor, describe, range(len(poses)), "compare", progress)
