"""When a tracker without a map asks anchors, and what it believes of them."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanTrackerOptions:
    """When anchors are asked, and what is believed."""

    sure_sigma_m: float = limit(
        0.2, "Position sigma up to which anchors are asked more rarely.", chosen="By hand: that of a fix."
    )
    sure_every: int = limit(
        4, "Frames from one question to the anchors to the next while the place is sure.", chosen="By hand."
    )
    unsure_every: int = limit(
        2, "The same while it is not, or not known at all.", chosen="By hand: a look costs several frames."
    )
    anchor_reach_m: float = limit(
        14.0,
        "Distance within which a phone recognizes a POI.",
        chosen="By hand: a print of a metre at 400 pixels.",
    )
    fix_reach_m: float = limit(
        1.5,
        "Beyond three sigmas of the place, how far a fix may be.",
        chosen="By hand: look-alikes are farther.",
    )
    doubtful_m: float = limit(
        6.0,
        "Path without a fix after which all anchors are asked, too.",
        chosen="By hand: the length of a room.",
    )
    everywhere_every: int = limit(
        4, "Of this many questions to the anchors one is to all, wherever the place.", chosen="By hand."
    )
    lost_sigma_m: float = limit(
        5.0, "Position sigma above which only a fix says where the camera is.", chosen="By hand: a room."
    )
    agreement_sigmas: float = limit(
        3.0, "A fix agrees with particles within this many of its sigmas.", chosen="By hand: three sigmas."
    )
    min_agreeing_share: float = limit(
        0.005, "Least share of particles that agree with a fix that is believed alone.", chosen="By hand."
    )
    confirmation_s: float = limit(
        8.0, "Longest time between two fixes that confirm each other.", chosen="By hand: a look around."
    )
    confirmation_m: float = limit(
        0.5, "Distance, beyond the way between, of two fixes that confirm each other.", chosen="By hand."
    )
    same_place_m: float = limit(
        1.0,
        "Distance within which the fixes by the same cameras err alike.",
        chosen="By hand: what they see, and its distance, is much the same.",
    )
    height_m: float = limit(1.5, "Height of a phone in a hand above the floor.", chosen="By hand.")
    least_height_m: float = limit(
        0.8, "Least height that is believed of a fix.", chosen="By hand: a child's."
    )
    most_height_m: float = limit(2.2, "Largest height that is believed of a fix.", chosen="By hand: held up.")
    tilt_sigma_deg: float = limit(
        2.0, "Sigma of the phone's tilt.", chosen="By hand: gravity's and odometry's."
    )
    resumed_m_s: float = limit(
        1.0,
        "Growth of the sigma of a place that was remembered while no frame came.",
        chosen="By hand: a pace.",
    )
    resumed_deg_s: float = limit(
        10.0, "The same of the heading's sigma.", chosen="By hand: a turn on the spot takes longer."
    )


OPTIONS = PlanTrackerOptions()
