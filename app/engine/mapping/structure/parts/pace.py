"""Whether a path moves no faster from one part to another than a person who films while walking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class PaceOptions:
    """How fast a path may be where it is not known."""

    usual_quantile: float = limit(
        0.9, "The usual speed is this quantile of the speeds from picture to picture.", chosen="By hand."
    )
    max_speed_ratio: float = limit(
        2.5,
        "Largest speed at a seam, relative to the usual speed of the same walk.",
        chosen="By hand: a person who films walks evenly or stands; look-alike places are seconds of walking apart.",
    )
    max_turn_deg_per_s: float = limit(
        180.0, "Largest speed of turning at a seam.", chosen="By hand: half a turn in a second."
    )
    slack_depth_ratio: float = limit(
        0.3,
        "Distance that a seam may have at any speed, relative to the median depth.",
        chosen="By hand: what the ends of parts drift by.",
    )
    slack_deg: float = limit(10.0, "The same of the attitude.", chosen="By hand: as of the distance.")
    leap_depth_ratio: float = limit(
        0.1,
        "Distance that two pictures of one part may be apart at any speed, relative to the median depth.",
        chosen="By hand: parts have no ends inside that could drift; on four paths of `roomfix evaluate-video` right "
        "steps need none of it, and the wrong ones were of 3.7 to 4.7 m.",
    )


OPTIONS = PaceOptions()


def usual_speed(poses: Mapping[int, Pose], times_s: Sequence[float]) -> float:
    """Return the usual speed from picture to picture, in the path's units a second; 0 for fewer than two."""
    speeds = [
        position_difference_m(poses[i], poses[j]) / max(times_s[j] - times_s[i], np.finfo(float).eps)
        for i, j in pairwise(sorted(poses))
        if j == i + 1
    ]
    return float(np.quantile(speeds, OPTIONS.usual_quantile)) if speeds else 0.0


def may_follow(a: Pose, b: Pose, seconds: float, speed: float, depth: float) -> bool:
    """Return whether the camera may move from one pose to the other in a time at a usual speed, given the median
    depth."""
    apart = position_difference_m(a, b)
    turn_deg = np.degrees(attitude_difference_rad(a, b))
    return bool(
        apart <= OPTIONS.slack_depth_ratio * depth + OPTIONS.max_speed_ratio * speed * seconds
        and turn_deg <= OPTIONS.slack_deg + OPTIONS.max_turn_deg_per_s * seconds
    )


def leaps(poses: Mapping[int, Pose], times_s: Sequence[float], depth: float) -> list[int]:
    """Return the pictures of a path after which the camera leaps: no person moves that far in the time to the next."""
    speed = usual_speed(poses, times_s)
    slack = OPTIONS.leap_depth_ratio * depth
    return [
        i
        for i, j in pairwise(sorted(poses))
        if position_difference_m(poses[i], poses[j])
        > slack + OPTIONS.max_speed_ratio * speed * (times_s[j] - times_s[i])
    ]


def is_walk(a: Mapping[int, Pose], b: Mapping[int, Pose], times_s: Sequence[float], depth: float) -> bool:
    """Return whether two paths in one frame may be those of one walk: at each seam, where a picture of one follows a
    picture of the other, the camera moves no faster than it does elsewhere."""
    speed = max(usual_speed(a, times_s), usual_speed(b, times_s))
    both = {**a, **b}
    seams = ((i, j) for i, j in pairwise(sorted(both)) if not ({i, j} <= a.keys() or {i, j} <= b.keys()))
    return all(may_follow(both[i], both[j], times_s[j] - times_s[i], speed, depth) for i, j in seams)
