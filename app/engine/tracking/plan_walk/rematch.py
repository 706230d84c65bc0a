"""A step that flow can't follow: features of both frames are matched, however far they moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.tracking.odometry.visual_odometry import ExpectedDistances
from app.engine.tracking.orb_matches import orb_features, orb_matches
from app.engine.tracking.plan_walk.two_views import FrameMatches
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class RematchOptions:
    """How two frames are matched, and when their relative pose is believed."""

    max_ratio: float = limit(
        0.85, "Largest ratio of the two least distances.", chosen="By hand: a usual one."
    )
    max_error_tangent: float = limit(
        tangent_of_px(8.0),
        "Inlier threshold: the reprojection error over the focal length.",
        chosen="By hand: distances by the plan are off by a fifth.",
    )
    min_inliers: int = limit(20, "Fewest inliers.", chosen="By hand: chance finds ten.")
    min_inlier_ratio: float = limit(0.4, "Least ratio of inliers to matches.", chosen="By hand.")


OPTIONS = RematchOptions()


def matches_between(before: Gray, now: Gray) -> FrameMatches | None:
    """Return the matched ORB features of two frames, or None where they are few."""
    points_a, features_a = orb_features(before)
    points_b, features_b = orb_features(now)
    rows_a, rows_b = orb_matches(features_a, features_b, OPTIONS.max_ratio)
    if len(rows_a) < OPTIONS.min_inliers:
        return None
    return FrameMatches(points_a[rows_a], points_b[rows_b])


def pose_by_matches(
    matches: FrameMatches, pose_before: Pose, expected: ExpectedDistances, camera: Camera
) -> Pose | None:
    """Return the pose of a frame by what it shows of the frame before, which is as far from there as expected, or None
    where too little agrees."""
    rays = homogeneous(camera.normalize(matches.before_px)) @ pose_before.rotation.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    away_m = expected(matches.before_px, camera, pose_before)
    found = estimate_pose_lo_ransac(
        matches.now_px,
        pose_before.translation + rays * away_m[:, None],
        camera,
        max_error_px=OPTIONS.max_error_tangent * camera.focal_px,
        max_iterations=500,
    )
    if found is None:
        return None
    count = int(np.count_nonzero(found.inlier_mask))
    is_sure = count >= max(OPTIONS.min_inliers, OPTIONS.min_inlier_ratio * len(matches.before_px))
    return found.world_from_camera if is_sure else None
