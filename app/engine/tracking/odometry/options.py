"""How odometry follows, places and gives up points."""

from __future__ import annotations

from dataclasses import dataclass

from app.geometry.camera import tangent_of_px
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryOptions:
    """How points are followed, placed and given up."""

    max_error_tangent: float = limit(
        tangent_of_px(3.0),
        "Inlier threshold of followed points: the reprojection error over the focal length.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    wanted_points: int = limit(
        300, "Points that are followed.", chosen="roomfix track and track-anchors; docs/sessions.md."
    )
    refill_share: float = limit(
        0.8,
        "New corners are searched for when fewer than this share of wanted_points is left.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    min_inliers: int = limit(
        15,
        "Fewest inliers of a step that can be trusted.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    min_inlier_ratio: float = limit(
        0.5,
        "Least ratio of inliers to followed points of a step that can be trusted.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    min_coverage: float = limit(
        0.12,
        "Least coverage of the inliers of a step that can be trusted.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    enough_fixed: int = limit(
        40,
        "Points of a fix that determine a pose without points of odometry.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    enough_coverage: float = limit(
        0.3,
        "Coverage of the points of a fix that determine a pose without points of odometry.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    most_fixed: int = limit(
        250,
        "Most points of a fix that are followed, the most certain ones.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    enough_found_share: float = limit(
        0.5,
        "When a smaller share is found after an assumed turn, the points are followed without it.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    neighbours: int = limit(
        5,
        "Placed points nearest to a new one, whose distance it is given at first.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    keyframe_every: int = limit(
        4,
        "Frames from one keyframe to the next.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    same_spot_tangent: float = limit(
        tangent_of_px(12.0),
        "Points within this radius of each other, over the focal length, are taken to be as far away.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    min_compared: int = limit(
        20,
        "Fewest pairs of points that determine the ratio of two scales.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    two_view_sigma: float = limit(
        0.15,
        "Relative sigma of a distance from two views: the error of their relative pose is shared by all points.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    same_point_tangent: float = limit(
        tangent_of_px(2.0),
        "A monitoring camera's point within this radius of a followed one, over the focal length, is that one.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    new_point_tangent: float = limit(
        tangent_of_px(6.0),
        "A monitoring camera's point without a followed one within this radius, over the focal length, is a new one.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    most_points: int = limit(
        400,
        "Most points that are followed with those of a monitoring camera.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    max_scale_sigma_ratio: float = limit(
        1.1,
        "Known distances change the scale only when its sigma is at most this many times the one before.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    expected_depth_sigma: float = limit(
        0.19,
        "Relative sigma of a distance by the floor plan; below 0.2 such a point counts as placed.",
        chosen="By hand: odometry can start from such points, and furniture is nearer by more only here and there.",
    )
    min_fix_sigma_m: float = limit(
        0.01,
        "Least standard deviation of the points of a fix.",
        chosen="By hand: the noise of a depth camera.",
    )


OPTIONS = OdometryOptions()
