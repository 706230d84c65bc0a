"""The user's pose by one keyframe alone (B 2.3): EPnP's camera-frame points, aligned with the keyframe's points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.query.accuracy import sigma_across
from app.engine.query.hypothesis import seen_from_one_side
from app.engine.query.vdm.keyframe_matches import KeyframeMatches
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_covariance
from app.geometry.epnp import solve_epnp
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeFixOptions:
    """When one keyframe gives a pose."""

    min_inliers: int = limit(
        8,
        "Fewest inliers: with fewer EPnP follows the noise of single points.",
        chosen="roomfix evaluate --pipeline vdm; docs/visual-depth-map.md.",
    )
    max_samples: int = limit(
        1000, "RANSAC iterations.", chosen="By hand: they find a pose that a fifth of the matches agree on."
    )
    epnp_error_factor: float = limit(
        1.6,
        "Error of EPnP, which weighs equations instead of pixels, over that of least squares.",
        chosen="On synthetic points with noise of 1 px: tests/engine/query/vdm/test_user_lines.py.",
    )


OPTIONS = KeyframeFixOptions()


@dataclass(frozen=True, slots=True)
class KeyframeFix:
    """Where one keyframe puts the user: its pose and the user's in the world, all matches and those that agree, and
    the covariance (6, 6) of the user's pose (rotation in world axes, then position)."""

    matches: KeyframeMatches
    inliers: KeyframeMatches
    world_from_keyframe: Pose
    world_from_user: Pose
    covariance: NDArray[np.float64]


def fix_by_keyframe(
    matches: KeyframeMatches, world_from_keyframe: Pose, camera: Camera, max_error_px: float
) -> KeyframeFix | None:
    """Return the user's pose by one keyframe, or None when its matches don't agree on one.

    RANSAC finds the matches that agree. From them EPnP makes points in the user's camera frame; aligned with the
    same points in the keyframe's frame they give R and t between both cameras, and the keyframe's pose the rest
    (B eq. 7-13 and what follows them).
    """
    found = estimate_pose_lo_ransac(
        matches.query_px,
        matches.points_in_world,
        camera,
        max_error_px=max_error_px,
        max_iterations=OPTIONS.max_samples,
    )
    if found is None or np.count_nonzero(found.inlier_mask) < OPTIONS.min_inliers:
        return None
    inliers = matches.take(found.inlier_mask)
    in_keyframe = world_from_keyframe.inverse().apply(inliers.points_in_world)
    try:
        keyframe_from_user = solve_epnp(inliers.query_px, in_keyframe, camera)
        world_from_user = world_from_keyframe @ keyframe_from_user
        errors = reprojection_errors_px(matches.query_px, matches.points_in_world, camera, world_from_user)
        # A wall in a mirror is the wall seen from behind.
        front = seen_from_one_side(
            matches.points_in_world, world_from_keyframe.translation, world_from_user.translation
        )
        inliers = matches.take((errors <= max_error_px) & front)
        if len(inliers) < OPTIONS.min_inliers:
            return None
        across = sigma_across(
            inliers.sigma_m,
            inliers.points_in_world,
            world_from_keyframe.translation,
            world_from_user.translation,
        )
        covariance = pose_covariance(
            inliers.query_px, inliers.points_in_world, camera, world_from_user, point_sigma_m=across
        )
    except DegenerateGeometryError:
        return None
    return KeyframeFix(
        matches, inliers, world_from_keyframe, world_from_user, OPTIONS.epnp_error_factor**2 * covariance
    )
