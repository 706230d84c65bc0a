"""What a searched focal length adds to the error of a pose."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from app.geometry.focal import ApproximateCamera, focal_position_error_m
from app.services.matches import Matches

if TYPE_CHECKING:
    from app.services.localizer import Localization


def with_focal_error(
    found: Localization, inliers: Matches, near: ApproximateCamera | None, max_position_m: float
) -> Localization:
    """Return what was found with the error of its focal length in its accuracy; no pose when that is too much.

    Before one flat wall a longer focal length and a larger distance look the same.
    """
    pose, camera = found.world_from_camera, found.camera
    if pose is None or camera is None or found.position_m is None:
        return found
    is_near_known = near is not None and near.covers(camera)
    focal_m = focal_position_error_m(inliers.points_px, inliers.points_in_world, camera, pose, is_near_known)
    position_m = float(np.hypot(found.position_m, focal_m))
    if position_m <= max_position_m:
        return replace(found, position_m=position_m)
    return replace(
        found,
        world_from_camera=None,
        reason="ambiguous",
        position_m=None,
        orientation_deg=None,
        confidence=0.0,
    )
