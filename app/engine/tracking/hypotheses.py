"""All poses that the matches of a frame with some keyframes agree on, not the best alone: which of them is meant is
told by where the camera can be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.maps.open_map import OpenMap
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class HypothesisOptions:
    """How all poses are found that the matches of a frame agree on."""

    max_poses: int = limit(
        4,
        "Poses after which the remaining matches agree by chance.",
        chosen="roomfix simulate and track; docs/sessions.md.",
    )
    max_error_tangent: float = limit(
        tangent_of_px(6.0),
        "Inlier threshold: the reprojection error over the focal length.",
        chosen="By hand: that of a single query.",
    )
    max_samples: int = limit(
        1000, "RANSAC iterations of each pose.", chosen="roomfix simulate and track; docs/sessions.md."
    )


OPTIONS = HypothesisOptions()


def poses_of(
    features: LocalFeatures, opened: OpenMap, keyframes: Sequence[int], camera: Camera
) -> Iterator[Pose]:
    """Yield the pose that most matches of a frame's features with keyframes agree on, then the one that most of the
    rest do, and so on while enough of them do. `camera` is the one of the features' pixels."""
    arrays, extractor = opened.artifact.arrays, opened.extractor
    unit = to_unit_vectors(features.descriptors, extractor.binary)
    pixels, points = [np.zeros((0, 2))], [np.zeros((0, 3))]
    for keyframe in keyframes:
        rows = opened.artifact.rows(keyframe)
        theirs = to_unit_vectors(arrays.descriptors[rows], extractor.binary)
        a, b, _ = match_unit_vectors(unit, theirs, extractor.ratio, extractor.binary)
        pixels.append(features.keypoints_px[a].astype(np.float64))
        points.append(arrays.points_in_world[rows][b].astype(np.float64))
    left_px, left_points = np.concatenate(pixels), np.concatenate(points)
    for _ in range(OPTIONS.max_poses):
        found = estimate_pose_lo_ransac(
            left_px,
            left_points,
            camera,
            max_error_px=OPTIONS.max_error_tangent * camera.focal_px,
            max_iterations=OPTIONS.max_samples,
        )
        if found is None or np.count_nonzero(found.inlier_mask) < extractor.min_inliers:
            return
        yield found.world_from_camera
        left_px, left_points = left_px[~found.inlier_mask], left_points[~found.inlier_mask]
