"""What a tracked camera is known to be doing, and what a session must not forget of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.engine.tracking.fix import WORLD
from app.geometry.lens import LENS_SIGMA
from app.geometry.se3 import Pose

State = Literal["initializing", "tracking", "relocalized", "lost"]


@dataclass(frozen=True, slots=True)
class TrackingMemory:
    """What a session must not forget: enough to go on after a restart.

    `world_from_camera` is the last trusted pose, at `time_s`;
    `fix_position_m`, `fix_orientation_deg` those of the last fix, `fix_scale_sigma` what its scale is off by, as a
    share; `unaided_m` and `unaided_rad` the path and the turns since; `pending` a fix that
    was too far off to be believed at once; `lens` the radial coefficient of a pinhole's lens as its frames show it, and
    one sigma of it.
    """

    state: State = "initializing"
    world_from_camera: Pose | None = None
    frame_id: str = WORLD
    time_s: float = 0.0
    fix_position_m: float = 0.0
    fix_orientation_deg: float = 0.0
    fix_scale_sigma: float = 0.0
    unaided_m: float = 0.0
    unaided_rad: float = 0.0
    pending: Pose | None = None
    pending_frame_id: str = WORLD
    pending_time_s: float = 0.0
    lens: tuple[float, float] = (0.0, LENS_SIGMA)
