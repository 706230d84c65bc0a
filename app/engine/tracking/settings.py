"""How often a tracker asks for fixes, and how far odometry and fixes are believed."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit

BY_WALKS = "roomfix simulate and track; docs/sessions.md."
BY_ANCHORS = "roomfix track-anchors; docs/anchors.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """How often a tracker asks for fixes, and how far odometry and fixes are believed.

    Without `use_refresh` the map around the pose is left alone, which is how odometry is measured; without
    `use_relocation` the map isn't used at all after the first fix; without `use_own_views` a session does not recognise
    what it has seen itself.
    """

    use_refresh: bool = True
    use_relocation: bool = True
    use_own_views: bool = True
    refresh_every: int = limit(
        4, "Frames from one search for map points around the pose to the next.", chosen=BY_WALKS
    )
    relocalize_every: int = limit(
        30,
        "Frames from one search everywhere to the next, where the map around the pose shows nothing.",
        chosen=BY_WALKS,
    )
    refresh_path_m: float = limit(
        0.3, "Path after which map points are searched for, however few frames it took.", chosen=BY_WALKS
    )
    refresh_turn_rad: float = limit(
        0.35, "Turn after which map points are searched for, however few frames it took.", chosen=BY_WALKS
    )
    wanted_scale_sigma: float = limit(
        0.04, "Relative sigma of the scale above which anchors are asked more often.", chosen=BY_ANCHORS
    )
    unknown_scale_every: int = limit(
        4,
        "Frames from one question to the anchors to the next while the scale is not known well.",
        chosen=BY_ANCHORS,
    )
    known_scale_every: int = limit(
        8, "Frames from one question to the anchors to the next once the scale is known.", chosen=BY_ANCHORS
    )
    max_gap_s: float = limit(
        1.0,
        "Time without a frame after which points can't be followed.",
        chosen="By hand: flow needs overlap.",
    )
    max_nearby_s: float = limit(
        3.0, "Time for which a camera is searched for near its last place before everywhere.", chosen=BY_WALKS
    )
    max_eager_s: float = limit(
        2.0,
        "Time without a fix after which a camera is searched for only every search_every_s.",
        chosen=BY_WALKS,
    )
    search_every_s: float = limit(
        0.45,
        "Time between two searches everywhere for a camera that has been lost for a while.",
        chosen=BY_WALKS,
    )
    max_correction_m: float = limit(
        0.25,
        "Correction of odometry by a fix, beyond three sigmas, above which one of both is wrong.",
        chosen=BY_WALKS,
    )
    max_astray_m: float = limit(
        1.0,
        "Distance from odometry's place, beyond three sigmas, within which a fix is searched for.",
        chosen=BY_WALKS,
    )
    max_prior_s: float = limit(
        30.0, "Time for which the last place decides between places that look alike.", chosen=BY_WALKS
    )
    max_sigma_m: float = limit(
        1.0,
        "Position sigma at which odometry's answers end.",
        chosen="By hand: a place known worse is no use.",
    )
    motion_slack_m: float = limit(
        0.15, "Difference that the phone's own odometry and ours may have.", chosen="By hand."
    )
    motion_ratio: float = limit(
        0.5, "Difference that the phone's own odometry and ours may have, over the step.", chosen="By hand."
    )
