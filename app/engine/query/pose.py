"""The pose that the matches of a picture with a map agree on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.engine.maps.artifact import MapArtifact
from app.engine.query.accuracy import seen_from_one_side
from app.engine.query.matches import Matches
from app.geometry.camera import Camera
from app.geometry.estimators.interface import MIN_POINTS
from app.geometry.pnp import PnpEstimate, estimate_pose_lo_ransac
from app.geometry.se3 import Pose


def pose_in_map(
    artifact: MapArtifact,
    matches: Matches,
    camera: Camera,
    max_error: float,
    max_iterations: int,
    prior: Pose | None = None,
) -> PnpEstimate | None:
    """Return the pose that most matches agree on, None when too few do.

    `max_error` is the inlier limit as an angle (tangent). A wall in a mirror is the wall seen from behind: a point
    counts only when seen from the side that its keyframe saw it from.
    """
    found = estimate_pose_lo_ransac(
        matches.points_px,
        matches.points_in_world,
        camera,
        max_error_px=max_error * camera.focal_px,
        max_iterations=max_iterations,
        prior=prior,
    )
    if found is None:
        return None
    centres = artifact.arrays.positions[matches.keyframes]
    front = seen_from_one_side(matches.points_in_world, centres, found.world_from_camera.translation)
    inliers = found.inlier_mask & front
    return replace(found, inlier_mask=inliers) if np.count_nonzero(inliers) >= MIN_POINTS else None
