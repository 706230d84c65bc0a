"""How odometry's error grows, and how far a camera can have come, by path, turns and time since the last fix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.query.placed import Accuracy
from app.engine.tracking.odometry.visual_odometry import OdometryStep
from app.engine.tracking.state import TrackingMemory
from app.geometry.se3 import attitude_difference_rad, position_difference_m
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionOptions:
    """How fast a person's camera moves, and how odometry drifts."""

    max_speed_m_s: float = limit(
        3.0, "Fastest that a camera moves.", chosen="By hand: twice a person's pace."
    )
    jerk_m: float = limit(0.4, "A step that a hand's jerk explains.", chosen="By hand: a short arm's swing.")
    max_free_m: float = limit(
        4.0,
        "However long a camera was not seen, a place farther than this from its last one needs a second fix.",
        chosen="By hand: the depth of a room; look-alike places are farther apart.",
    )
    drift_ratio: float = limit(
        0.04,
        "Standard deviation of odometry's position over the path.",
        chosen="roomfix track; docs/sessions.md.",
    )
    turn_drift_ratio: float = limit(
        0.08,
        "Standard deviation of odometry's attitude over the turns.",
        chosen="roomfix track; docs/sessions.md.",
    )
    turn_distance_m: float = limit(
        1.5,
        "Distance of what is seen, at which an error of attitude becomes one of position: a lens that differs from its "
        "model makes a step of a turn.",
        chosen="By hand: the distance of things in a room.",
    )


MOTION = MotionOptions()


def unaided(memory: TrackingMemory, step: OdometryStep) -> tuple[float, float]:
    """Return the path, metres, and the turns, radians, since the last fix, with a step from its pose."""
    last = memory.frame_from_camera
    assert last is not None  # noqa: S101 - a step follows a pose
    pose = step.frame_from_camera
    return (
        memory.unaided_m + position_difference_m(pose, last),
        memory.unaided_rad + attitude_difference_rad(pose, last),
    )


def accuracy_after(memory: TrackingMemory, step: OdometryStep) -> Accuracy:
    """Return how accurate a step's pose is: the errors of position and attitude grow with path and turns since the
    last fix."""
    unaided_m, unaided_rad = unaided(memory, step)
    turned_rad = MOTION.turn_drift_ratio * unaided_rad
    drift_m = float(np.hypot(MOTION.drift_ratio, memory.fix_scale_sigma)) * unaided_m
    fix, own = memory.fix_accuracy, step.accuracy
    position_m = [own.position_m, fix.position_m, drift_m, turned_rad * MOTION.turn_distance_m]
    orientation_deg = [own.orientation_deg, fix.orientation_deg, float(np.degrees(turned_rad))]
    return Accuracy(float(np.linalg.norm(position_m)), float(np.linalg.norm(orientation_deg)))


def reach_m(memory: TrackingMemory, time_s: float, fix_position_m: float = 0.0) -> float:
    """Return how far from its last place a camera can be at a time, the place's own error included."""
    waited_s = max(time_s - memory.time_s, 0.0)
    turned_m = MOTION.turn_drift_ratio * MOTION.turn_distance_m * memory.unaided_rad
    errors_m = [memory.fix_accuracy.position_m, MOTION.drift_ratio * memory.unaided_m, turned_m]
    drift_m = float(np.linalg.norm(errors_m))
    moved_m = min(MOTION.max_speed_m_s * waited_s, MOTION.max_free_m)
    return MOTION.jerk_m + moved_m + 3.0 * float(np.hypot(drift_m, fix_position_m))
