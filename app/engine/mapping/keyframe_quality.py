"""Keyframes that are blurred or badly exposed, and the frames near them that replace them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.limits import limit
from app.vision.images import ImageQuality
from app.vision.keyframes import PoseThresholds


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeQualityOptions:
    """When a frame is blurred, and how far a replacement is searched for."""

    min_sharpness_ratio: float = limit(
        0.25,
        "Least ratio of a frame's sharpness to the median of the scan; below it the frame is blurred.",
        chosen="By hand; no measurement is recorded.",
    )
    max_candidates: int = limit(
        20,
        "Largest number of frames near an unusable keyframe that are tried in its place.",
        chosen="By hand: a blur that lasts longer is a part of the scan without good frames.",
    )


OPTIONS = KeyframeQualityOptions()


def blur_limit(qualities: Iterable[ImageQuality]) -> float:
    """Return the sharpness below which a frame of the scan counts as blurred."""
    return OPTIONS.min_sharpness_ratio * float(np.median([quality.sharpness for quality in qualities]))


def fault_of(quality: ImageQuality, blur_limit: float) -> str | None:
    """Return why a frame can't be a keyframe, `badly_exposed` or `blurred`, or None when it can."""
    if quality.is_poor:
        return "badly_exposed"
    return "blurred" if quality.sharpness < blur_limit else None


def find_replacements(
    selected: Sequence[int],
    usable: Sequence[int],
    poses: Sequence[Pose],
    thresholds: PoseThresholds,
    is_good: Callable[[int], bool],
) -> dict[int, int]:
    """Return the frame (row) that replaces each unusable keyframe (row), where there is one.

    `selected` are the rows of all keyframes, `usable` those of the usable ones. The replacement is the nearest good
    frame within both thresholds, by `_nearness` and then by time. A keyframe that is close to another keyframe is not
    replaced.
    """
    kept, taken, replaced = list(usable), set(selected), dict[int, int]()
    for row in sorted(set(selected) - set(usable)):
        if any(_nearness(poses[row], poses[other], thresholds) < 1.0 for other in kept):
            continue
        nearness = {
            other: _nearness(poses[row], poses[other], thresholds)
            for other in range(len(poses))
            if other not in taken
        }
        near = [other for other in nearness if nearness[other] < 1.0]
        near.sort(key=lambda other, row=row, nearness=nearness: (nearness[other], abs(other - row)))  # type: ignore[misc]
        found = next((other for other in near[: OPTIONS.max_candidates] if is_good(other)), None)
        if found is not None:
            replaced[row] = found
            kept.append(found)
            taken.add(found)
    return replaced


def _nearness(a: Pose, b: Pose, thresholds: PoseThresholds) -> float:
    """Return the larger of the differences in position and attitude, each divided by its threshold."""
    return max(
        position_difference_m(a, b) / thresholds.position_m,
        attitude_difference_rad(a, b) / thresholds.attitude_rad,
    )
