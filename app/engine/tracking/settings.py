"""How often a tracker asks for fixes, and how far odometry and fixes are believed."""

from __future__ import annotations

from dataclasses import dataclass

from app.geometry.camera import tangent_of_px
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


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFixOptions:
    """How a map is asked near a place that is already known."""

    covisible_keyframes: int = limit(
        6,
        "Keyframes whose points are searched for around a predicted pose.",
        chosen=BY_WALKS,
    )
    nearby_keyframes: int = limit(
        10,
        "Keyframes that are matched around the last place, and of those that look alike there.",
        chosen=BY_WALKS,
    )
    search_radius_tangent: float = limit(
        tangent_of_px(24.0),
        "Radius around its projection by a predicted pose within which a point is searched for, over the focal length.",
        chosen=BY_WALKS,
    )
    found_radius_tangent: float = limit(
        tangent_of_px(8.0),
        "Radius around its projection by a pose that was found within which a point is searched for, "
        "over the focal length.",
        chosen=BY_WALKS,
    )
    max_error_tangent: float = limit(
        tangent_of_px(6.0),
        "Inlier threshold: the reprojection error over the focal length.",
        chosen="By hand: that of a single query.",
    )
    guided_inlier_factor: float = limit(
        1.5,
        "Fewest inliers near a predicted pose, as a multiple of min_inliers: there points agree more easily by chance.",
        chosen=BY_WALKS,
    )
    guided_inlier_ratio: float = limit(
        0.5,
        "Least ratio of inliers to matches near a predicted pose.",
        chosen=BY_WALKS,
    )
    guided_coverage: float = limit(
        0.15,
        "Least coverage of the inliers near a predicted pose.",
        chosen=BY_WALKS,
    )
    prior_radius_m: float = limit(
        6.0,
        "A place farther than this from the last one may be a look-alike: the last place then decides.",
        chosen=BY_WALKS,
    )
    prior_climb_m: float = limit(
        2.0,
        "A place higher or lower than this than the last one may be a look-alike on another floor.",
        chosen="By hand: less than a storey.",
    )
    upright_cosine: float = limit(
        0.7, "Cosine of the tilt below which a camera counts as held upright.", chosen="By hand: 45 degrees."
    )
    known_reach_m: float = limit(
        1.0,
        "Reach within which a camera still faces the way it did.",
        chosen=BY_WALKS,
    )
    view_reach_m: float = limit(
        4.0,
        "Beyond known_reach_m, how much farther keyframes may be that see what the camera sees.",
        chosen=BY_WALKS,
    )
    sure_inlier_factor: float = limit(
        2.5,
        "Beyond known_reach_m, fewest inliers of a fix, as a multiple of min_inliers.",
        chosen=BY_WALKS,
    )
    sure_coverage: float = limit(
        0.2,
        "Beyond known_reach_m, least coverage of the inliers of a fix.",
        chosen=BY_WALKS,
    )
    max_contradicted_share: float = limit(
        0.12,
        "Largest share of the picture that may contradict a pose that was found where it was searched for.",
        chosen=BY_WALKS,
    )
    max_rival_share: float = limit(
        0.45,
        "Of two places within reach, most inliers of the weaker one over those of the stronger.",
        chosen="By hand: as in a single query.",
    )
    sure_confidence: float = limit(
        0.9,
        "Least confidence of a fix of a camera of whose place nothing is known: the next frames may see more.",
        chosen="By hand: an answer counts as sure from it on. All wrong floors that walkers on a floor that nobody "
        "scanned were told began with less (roomfix simulate --from-floor 1, seed 7).",
    )
