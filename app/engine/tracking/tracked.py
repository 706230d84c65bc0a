"""What tracking answers for a frame."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.query.verification import Reason
from app.engine.tracking.fix import Fix
from app.engine.tracking.state import State, TrackingMemory
from app.geometry.camera import Camera
from app.geometry.se3 import Pose


@dataclass(frozen=True, slots=True)
class Tracked:
    """The outcome for one frame; `world_from_camera` is None exactly when `reason` says why."""

    state: State
    world_from_camera: Pose | None
    reason: Reason | None
    method: str
    frame_id: str
    position_m: float | None
    orientation_deg: float | None
    confidence: float
    inliers: int
    matches: int
    unaided_m: float
    camera: Camera | None
    fix: Fix | None = None


def nothing_tracked(
    state: State, reason: Reason, inliers: int, matches: int, camera: Camera | None, memory: TrackingMemory
) -> Tracked:
    """Return the outcome for a frame that can't be located."""
    return Tracked(
        state,
        None,
        reason,
        "rgbd",
        memory.frame_id,
        None,
        None,
        0.0,
        inliers,
        matches,
        memory.unaided_m,
        camera,
    )
