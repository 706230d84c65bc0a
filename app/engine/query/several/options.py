"""Limits of one answer from several frames."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SeveralOptions:
    """When frames agree with each other, and what each of them adds."""

    same_thing_m: float = limit(
        0.05,
        "World points nearer than this are one thing, which counts once however many frames show it.",
        chosen="By hand: twice the noise of a map's point across a room.",
    )
    min_frame_inliers: int = limit(
        6,
        "Fewest inliers of a frame that confirms where another frame is, and so the motion between them.",
        chosen="By hand: half of what a pose of one frame needs. Three points fit any pose, four may by chance.",
    )
    motion_tolerance_m: float = limit(
        0.1,
        "Poses of frame 0 by two frames alone and their motion agree when this near, and max_sigmas more.",
        chosen="By hand: the map's own error, which depends on the place, and that of the motion.",
    )
    motion_tolerance_deg: float = limit(
        5.0,
        "As motion_tolerance_m, for the angle between the two poses.",
        chosen="By hand: 0.2 m for what is two metres away.",
    )
    usual_depth_m: float = limit(
        2.0,
        "Distance at which a standard deviation of the position allows the same one of the angle.",
        chosen="By hand: across half of a room, as for motion_tolerance_deg.",
    )
    max_sigmas: float = limit(
        3.0,
        "Standard deviations by which positions that agree may differ.",
        chosen="By hand: 99.7 % of a normal error.",
    )
    motion_sigma_ratio: float = limit(
        0.02,
        "Standard deviation of a motion, relative to its length.",
        chosen="By hand: visual-inertial odometry of phones drifts by one or two percent.",
    )
    motion_sigma_deg: float = limit(
        0.1, "Standard deviation of the rotation of a motion.", chosen="By hand: as motion_sigma_ratio."
    )
    turn_sigma_ratio: float = limit(
        0.02,
        "Standard deviation of the rotation of a motion, relative to its angle; motion_sigma_deg is added to it.",
        chosen="By hand: a phone that turns by 60 degrees in a second turns by 0.2 in the 4 ms that the clocks of its "
        "camera and of its motion differ by, in a fifth of a second 2 % of the turn.",
    )
    max_spread_m: float = limit(
        2.0,
        "Frames whose motion is not known were taken within this distance of each other.",
        chosen="By hand: more than a walker goes in a second, less than the distance of two look-alike rooms.",
    )


OPTIONS = SeveralOptions()
