"""What a tracked camera is known to be doing, and what a session must not forget of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.engine.query.placed import WORLD, Accuracy, PlacedPose
from app.geometry.lens import LENS_SIGMA
from app.geometry.se3 import Pose

State = Literal["initializing", "tracking", "relocalized", "lost"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingMemory:
    """What a session must not forget: enough to go on after a restart.

    `last` is the last trusted pose, at `time_s`; `fix_accuracy` that of the last fix, `fix_scale_sigma` the relative
    standard deviation of its scale; `unaided_m` and `unaided_rad` the path and the turns since; `pending` a fix, at
    `pending_time_s`, that was too far off to be believed at once; `lens` the radial coefficient of a pinhole's lens as
    its frames show it, and one sigma of it. `camera_sigma` is what was not known of the camera at the last fix that
    looked at it, alike in all its pictures: part of every answer, and no part of what tells fixes from odometry.
    """

    state: State = "initializing"
    last: PlacedPose | None = None
    time_s: float = 0.0
    fix_accuracy: Accuracy = Accuracy(0.0, 0.0)
    fix_scale_sigma: float = 0.0
    unaided_m: float = 0.0
    unaided_rad: float = 0.0
    pending: PlacedPose | None = None
    pending_time_s: float = 0.0
    lens: tuple[float, float] = (0.0, LENS_SIGMA)
    camera_sigma: Accuracy = Accuracy(0.0, 0.0)

    @property
    def frame_id(self) -> str:
        """The frame of the last trusted pose; the world before there is one."""
        return WORLD if self.last is None else self.last.frame_id

    @property
    def frame_from_camera(self) -> Pose | None:
        """The last trusted pose in its frame; None before there is one."""
        return None if self.last is None else self.last.frame_from_camera
