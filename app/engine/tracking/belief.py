"""Whether a fix, or a step of odometry, can be believed by where the camera was, and a fix by an earlier one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.query.placed import WORLD
from app.engine.tracking.drift import MOTION, accuracy_after, reach_m
from app.engine.tracking.fix import Fix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.odometry.visual_odometry import OdometryStep
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.state import TrackingMemory
from app.engine.tracking.surroundings import Surroundings
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.limits import limit

BY_WALKS = "roomfix simulate and track; docs/sessions.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class BeliefOptions:
    """When a fix is believed."""

    max_climb_m: float = limit(
        1.2,
        "A change of height that no step explains: another storey.",
        chosen="By hand: half a storey and less.",
    )
    max_confirmation_s: float = limit(
        5.0, "Longest time between two fixes that confirm each other.", chosen=BY_WALKS
    )
    min_away_s: float = limit(
        10.0,
        "Time without a fix after which a place out of reach, or on another floor, is believed when confirmed: all "
        "frames of one look-alike place confirm each other.",
        chosen=BY_WALKS,
    )
    confirmation_turn_deg: float = limit(
        30.0, "Turn between two fixes that a hand's jerk explains at any time.", chosen="By hand."
    )
    max_turn_deg_s: float = limit(
        180.0, "Fastest that a camera turns.", chosen="By hand: half a turn a second."
    )


BELIEF = BeliefOptions()


def can_be_followed(
    memory: TrackingMemory,
    step: OdometryStep,
    frame: TrackingFrame,
    predicted: Pose,
    settings: TrackerSettings,
) -> bool:
    """Whether a person's camera can have made odometry's step to a frame: by its speed, by what the phone itself says
    of the motion (`predicted`), and by how uncertain the place has become."""
    last = memory.frame_from_camera
    assert last is not None  # noqa: S101 - a step follows a pose
    elapsed_s = max(frame.time_s - memory.time_s, 0.0)
    moved_m = position_difference_m(step.frame_from_camera, last)
    if moved_m > MOTION.jerk_m + MOTION.max_speed_m_s * elapsed_s:
        return False
    if frame.motion is not None:
        off_m = position_difference_m(step.frame_from_camera, predicted)
        stride_m = float(np.linalg.norm(frame.motion.translation))
        if off_m > settings.motion_slack_m + settings.motion_ratio * stride_m:
            return False
    # A scale that is not known well shows in the sigma, which grows with the path.
    return accuracy_after(memory, step).position_m <= settings.max_sigma_m


def is_inside(fix: Fix, surroundings: Surroundings) -> bool:
    """Whether a camera can be where a fix has it; on a plan alone nothing is known of that."""
    return fix.frame_id != WORLD or surroundings.is_inside(fix.frame_from_camera)


def is_plausible(memory: TrackingMemory, fix: Fix, predicted: Pose, time_s: float) -> bool:
    """Whether the camera can have come from its last place to a fix in the time between."""
    if fix.frame_id != memory.frame_id:
        return False
    offset = fix.frame_from_camera.translation - predicted.translation
    within_m = reach_m(memory, time_s, fix.accuracy.position_m)
    return float(np.linalg.norm(offset)) <= within_m and abs(float(offset[2])) <= BELIEF.max_climb_m


def is_confirmed(memory: TrackingMemory, fix: Fix, time_s: float, surroundings: Surroundings) -> bool:
    """Whether a fix agrees with the one that waits for confirmation, and may be believed where it is."""
    pending, waited_s = memory.pending, time_s - memory.pending_time_s
    if pending is None or fix.frame_id != pending.frame_id:
        return False
    if not 0.0 <= waited_s <= BELIEF.max_confirmation_s:
        return False
    apart_m = position_difference_m(fix.frame_from_camera, pending.frame_from_camera)
    turned_deg = np.degrees(attitude_difference_rad(fix.frame_from_camera, pending.frame_from_camera))
    agrees = (
        apart_m <= MOTION.jerk_m + MOTION.max_speed_m_s * waited_s
        and turned_deg <= BELIEF.confirmation_turn_deg + BELIEF.max_turn_deg_s * waited_s
    )
    was_away = abs(time_s - memory.time_s) >= BELIEF.min_away_s
    is_far_away = was_away or may_be_elsewhere(memory, time_s, surroundings)
    return agrees and (is_near(memory, fix) or is_far_away)


def may_be_elsewhere(memory: TrackingMemory, time_s: float, surroundings: Surroundings) -> bool:
    """Whether the camera may have left the floor where it was seen last."""
    last = memory.last
    if last is None or last.frame_id != WORLD:
        return False
    return surroundings.can_change_floor(last.frame_from_camera, abs(time_s - memory.time_s))


def is_near(memory: TrackingMemory, fix: Fix) -> bool:
    """Whether a fix is on the floor where the camera was last, and no look-alike place elsewhere."""
    last = memory.last
    if last is None or fix.frame_id != last.frame_id:
        return True
    offset = fix.frame_from_camera.translation - last.frame_from_camera.translation
    return float(np.linalg.norm(offset)) <= MOTION.max_free_m and abs(float(offset[2])) <= BELIEF.max_climb_m
