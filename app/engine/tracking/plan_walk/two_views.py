"""A step by two views alone: turn and direction by matches, the length by the distances that the floor plan has.

A pose by points needs all of their distances to be right; the turn between two views needs none of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.tracking.odometry.visual_odometry import ExpectedDistances
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.epipolar import RelativePoseEstimate, estimate_relative_pose
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous, pixel_depths
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoViewStepOptions:
    """When the relative pose of two frames is believed."""

    max_error_tangent: float = limit(
        tangent_of_px(2.0),
        "Inlier threshold: the epipolar error over the focal length.",
        chosen="By hand: blur by a turn moves corners by two pixels.",
    )
    min_inliers: int = limit(20, "Fewest inliers.", chosen="By hand: chance finds ten.")
    min_inlier_ratio: float = limit(0.35, "Least ratio of inliers to matches.", chosen="By hand.")
    max_iterations: int = limit(300, "RANSAC samples.", chosen="By hand: a few milliseconds.")


OPTIONS = TwoViewStepOptions()


@dataclass(frozen=True, slots=True)
class FrameMatches:
    """Matched pixels of two frames, (n, 2) each."""

    before_px: Array
    now_px: Array


def pose_by_two_views(
    matches: FrameMatches, pose_before: Pose, expected: ExpectedDistances, camera: Camera
) -> Pose | None:
    """Return the pose of a frame by its matches with the frame before, or None where too few agree on one.

    The translation is as long as makes the distances of the inliers, in the median of their ratios, as expected.
    """
    found = estimate_relative_pose(
        matches.before_px,
        matches.now_px,
        camera,
        camera,
        max_error_px=OPTIONS.max_error_tangent * camera.focal_px,
        max_iterations=OPTIONS.max_iterations,
    )
    if found is None:
        return None
    count = int(np.count_nonzero(found.inlier_mask))
    if count < max(OPTIONS.min_inliers, OPTIONS.min_inlier_ratio * len(matches.before_px)):
        return None
    length_m = _length_m(matches, found, pose_before, expected, camera)
    before_from_now = found.b_from_a.inverse()
    return pose_before @ Pose(before_from_now.rotation, length_m * before_from_now.translation)


def _length_m(
    matches: FrameMatches,
    found: RelativePoseEstimate,
    pose_before: Pose,
    expected: ExpectedDistances,
    camera: Camera,
) -> float:
    """Return the length of the translation between two frames in metres."""
    before_px, now_px = matches.before_px[found.inlier_mask], matches.now_px[found.inlier_mask]
    rays = camera.normalize(before_px)
    depths, _ = pixel_depths(rays, camera.normalize(now_px), found.b_from_a)
    in_translations = depths * np.linalg.norm(homogeneous(rays), axis=1)
    return float(np.median(expected(before_px, camera, pose_before) / in_translations))
