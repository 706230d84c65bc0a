"""What tracking answers for a frame."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.query.verification import Reason
from app.engine.tracking.fix import Fix
from app.engine.tracking.own_view import SeenAgain
from app.engine.tracking.state import State
from app.geometry.camera import Camera
from app.geometry.se3 import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracked:
    """The outcome for one frame; `placed` is None exactly when `reason` says why.

    `unaided_m` is the path since the last fix, metres; `by_odometry` where odometry has the camera, for a fix that
    corrects it, or for a view of the session's own past that is `seen_again`.
    """

    state: State
    placed: PlacedPose | None = None
    reason: Reason | None = None
    method: str = "rgbd"
    accuracy: Accuracy | None = None
    confidence: float = 0.0
    support: Support = Support()
    unaided_m: float
    camera: Camera | None
    fix: Fix | None = None
    by_odometry: Pose | None = None
    seen_again: SeenAgain | None = None
