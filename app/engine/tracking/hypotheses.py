"""All poses that the matches of a frame with some keyframes agree on, not the best alone: which of them is meant is
told by where the camera can be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from app.engine.maps.open_map import OpenMap
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors

# After so many poses the rest agrees by chance.
MAX_POSES = 4
MAX_ERROR = tangent_of_px(6.0)
MAX_SAMPLES = 1000


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
    for _ in range(MAX_POSES):
        found = estimate_pose_lo_ransac(
            left_px,
            left_points,
            camera,
            max_error_px=MAX_ERROR * camera.focal_px,
            max_iterations=MAX_SAMPLES,
        )
        if found is None or np.count_nonzero(found.inlier_mask) < extractor.min_inliers:
            return
        yield found.world_from_camera
        left_px, left_points = left_px[~found.inlier_mask], left_points[~found.inlier_mask]
