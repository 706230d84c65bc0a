"""The frames of a scan that take part in loop closure, and the pairs of them that may see the same place again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.limits import limit

Array = NDArray[np.float64]
Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceOptions:
    """Which frames are compared with which."""

    step_m: float = limit(
        0.15,
        "Way from one frame that takes part to the next; a turn counts as `metres_per_rad` says.",
        chosen="By hand: neighbours then share most of their view.",
    )
    metres_per_rad: float = limit(
        1.0,
        "Metres of way that a turn of one radian counts as.",
        chosen="By hand: both change half of a view.",
    )
    max_places: int = limit(
        500,
        "Frames that take part at most; a longer scan gets longer steps.",
        chosen="By hand: minutes of work.",
    )
    min_way_m: float = limit(
        3.0,
        "Least way between two frames that may close a loop.",
        chosen="By hand: nearer ones say little of drift.",
    )
    retrieved: int = limit(
        6,
        "Most similar other frames that each one is compared with.",
        chosen="By hand: a place has some views.",
    )
    ties: int = limit(
        2,
        "Next frames that each one is compared with too: their depth measures the steps of the path.",
        chosen="By hand: further ones share little of the view.",
    )
    reach_m: float = limit(
        2.0, "Largest distance of two cameras that see the same from near enough.", chosen="By hand: a room."
    )
    max_turn_rad: float = limit(
        1.0, "Largest angle between their attitudes.", chosen="By hand: less than the width of a view."
    )
    drift_ratio: float = limit(
        0.04,
        "Drift of the position that is looked for, as a ratio of the way between two frames.",
        chosen="By hand: several times what trackers have; look-alike places are further off.",
    )
    drift_rad_per_m: float = limit(
        0.02,
        "Drift of the attitude that is looked for, per metre of way.",
        chosen="By hand: as the position's.",
    )
    most_drift_rad: float = limit(0.5, "Largest drift of the attitude.", chosen="By hand: 30 degrees.")


OPTIONS = PlaceOptions()


def ways_m(poses: Sequence[Pose]) -> Array:
    """Return the way (n,) from the first pose to each one, turns included."""
    steps = [
        position_difference_m(a, b) + OPTIONS.metres_per_rad * attitude_difference_rad(a, b)
        for a, b in pairwise(poses)
    ]
    return np.concatenate([[0.0], np.cumsum(steps)])


def choose_places(way_m: Array) -> list[int]:
    """Return the rows of the frames that take part, the first and the last among them."""
    step = max(OPTIONS.step_m, float(way_m[-1]) / OPTIONS.max_places)
    chosen = [0]
    for row in range(1, len(way_m)):
        if way_m[row] - way_m[chosen[-1]] >= step:
            chosen.append(row)
    return chosen if chosen[-1] == len(way_m) - 1 else [*chosen, len(way_m) - 1]


def may_be_near(poses: Sequence[Pose], way_m: Array) -> NDArray[np.bool_]:
    """Return which pairs (n, n) of poses are far apart on the way, and by the poses and what they may have drifted so
    near that they see the same."""
    positions = np.stack([pose.translation for pose in poses])
    forward = np.stack([pose.rotation[:, 2] for pose in poses])
    between = np.abs(way_m[:, None] - way_m)
    apart = np.linalg.norm(positions[:, None] - positions, axis=2)
    angle = np.arccos(np.clip(forward @ forward.T, -1.0, 1.0))
    return np.asarray(
        (between >= OPTIONS.min_way_m)
        & (apart <= OPTIONS.reach_m + drift_m(between))
        & (angle <= OPTIONS.max_turn_rad + drift_rad(between))
    )


def ties_of(places: Sequence[Pose]) -> list[Pair]:
    """Return the pairs of places beside each other on the way that see the same."""
    count = len(places)
    pairs = [(i, i + step) for i in range(count) for step in range(1, OPTIONS.ties + 1) if i + step < count]
    return [
        (i, j)
        for i, j in pairs
        if position_difference_m(places[i], places[j]) <= OPTIONS.reach_m
        and attitude_difference_rad(places[i], places[j]) <= OPTIONS.max_turn_rad
    ]


def drift_m(way_m: ArrayLike) -> Array:
    """Return the drift of the position that is looked for after ways of any shape."""
    return np.asarray(OPTIONS.drift_ratio * np.asarray(way_m, dtype=np.float64))


def drift_rad(way_m: ArrayLike) -> Array:
    """Return the drift of the attitude that is looked for after ways of any shape."""
    return np.minimum(OPTIONS.drift_rad_per_m * np.asarray(way_m, dtype=np.float64), OPTIONS.most_drift_rad)


def pairs_to_compare(near: NDArray[np.bool_], descriptors: NDArray[np.float32]) -> list[Pair]:
    """Return pairs (i < j) among those of `near` (n, n), the most similar by their global descriptors (n, d)."""
    similarity = np.where(near, descriptors @ descriptors.T, -np.inf)
    best = np.argsort(-similarity, axis=1)[:, : OPTIONS.retrieved]
    return sorted({(min(i, j), max(i, j)) for i, row in enumerate(best.tolist()) for j in row if near[i, j]})
