"""What odometry is off by, and how far a camera can have come, by path, turns and time since the map was seen."""

from __future__ import annotations

import numpy as np

from app.engine.tracking.odometry import OdometryStep
from app.engine.tracking.state import TrackingMemory
from app.geometry.se3 import attitude_difference_rad, position_difference_m

# A person's pace with room for a hand's jerk; what is further off was no motion.
MAX_SPEED_M_S, JERK_M = 3.0, 0.4
# However long a camera was not seen, what is further from where it was is believed only when it is seen twice.
MAX_FREE_M = 4.0
# What odometry is off by after a metre of path (roomfix track).
DRIFT_SHARE = 0.04
# What it is off by after a turn, as a share of the turn, and at what distance a turn looks like a step: a lens that
# differs from its model a little makes one of the other.
TURN_DRIFT_SHARE, TURN_DISTANCE_M = 0.08, 1.5


def unaided(memory: TrackingMemory, step: OdometryStep) -> tuple[float, float]:
    """Return the path, metres, and the turns, radians, since the last fix, with a step from its pose."""
    assert memory.world_from_camera is not None  # noqa: S101 - a step follows a pose
    pose = step.world_from_camera
    return (
        memory.unaided_m + position_difference_m(pose, memory.world_from_camera),
        memory.unaided_rad + attitude_difference_rad(pose, memory.world_from_camera),
    )


def sigma_of(memory: TrackingMemory, step: OdometryStep) -> tuple[float, float]:
    """Return one sigma of a step's position, metres, and attitude, degrees: both grow with path and turns since the
    last fix."""
    unaided_m, unaided_rad = unaided(memory, step)
    turned_rad = TURN_DRIFT_SHARE * unaided_rad
    drift_m = float(np.hypot(DRIFT_SHARE, memory.fix_scale_sigma)) * unaided_m
    position_m = [step.position_m, memory.fix_position_m, drift_m, turned_rad * TURN_DISTANCE_M]
    orientation_deg = [step.orientation_deg, memory.fix_orientation_deg, float(np.degrees(turned_rad))]
    return float(np.linalg.norm(position_m)), float(np.linalg.norm(orientation_deg))


def reach_m(memory: TrackingMemory, time_s: float, fix_position_m: float = 0.0) -> float:
    """Return how far from its last place, and from what that was off by, a camera can be at a time."""
    waited_s = max(time_s - memory.time_s, 0.0)
    turned_m = TURN_DRIFT_SHARE * TURN_DISTANCE_M * memory.unaided_rad
    drift_m = float(np.linalg.norm([memory.fix_position_m, DRIFT_SHARE * memory.unaided_m, turned_m]))
    moved_m = min(MAX_SPEED_M_S * waited_s, MAX_FREE_M)
    return JERK_M + moved_m + 3.0 * float(np.hypot(drift_m, fix_position_m))
