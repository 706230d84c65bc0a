"""A fix by a monitoring camera beside odometry whose scale rests on another fix: what both have in common."""

from __future__ import annotations

from dataclasses import replace

from app.engine.query.placed import PlacedPose
from app.engine.tracking.events import Corrected
from app.engine.tracking.fix import Fix
from app.engine.tracking.odometry.visual_odometry import Odometry
from app.engine.tracking.state import TrackingMemory
from app.engine.tracking.two_view_fix import TrackedPlace, at_common_scale


def at_scale_of_both(odometry: Odometry, event: Corrected, memory: TrackingMemory) -> tuple[Fix, bool] | None:
    """Return the fix to believe, and whether odometry was brought to its scale; None where the two scales contradict
    each other.

    A fix or an odometry whose scale is known is taken as it is.
    """
    fix, scale_sigma = event.fix, memory.fix_scale_sigma
    if fix.scale_sigma <= 0 or scale_sigma <= 0:
        return fix, False
    ratio = odometry.distance_ratio(fix)
    if ratio is None:
        return fix, False
    own = PlacedPose(event.step.frame_from_camera, memory.frame_id)
    common = at_common_scale(fix, TrackedPlace(own, event.accuracy, scale_sigma), ratio)
    if common is None:
        return None
    seen, (fix, factor) = fix.seen, common
    sigma = odometry.adjust_with(fix, ratio)
    if sigma is not None and seen is not None:
        turn = fix.frame_from_camera.rotation @ own.frame_from_camera.rotation.T
        beside = odometry.beside_monitor(seen.frame_from_camera.translation, turn)
        fix = replace(fix, placed=replace(fix.placed, frame_from_camera=beside), scale_sigma=sigma)
        factor = 1.0
    odometry.rescale(factor, fix.frame_from_camera)
    return fix, True
