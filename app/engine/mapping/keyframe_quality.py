"""Keyframes that can't be used, and the frames beside them that take their places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.vision.images import ImageQuality
from app.vision.keyframes import PoseThresholds

# A frame is blurred when its sharpness is below this share of the scan's median.
BLURRED_SHARE = 0.25
# So many frames beside a keyframe are looked at; a blur that lasts longer is a stretch without good frames.
MAX_TRIED = 20


def blur_limit(qualities: Iterable[ImageQuality]) -> float:
    """Return the sharpness below which a frame of the scan counts as blurred."""
    return BLURRED_SHARE * float(np.median([quality.sharpness for quality in qualities]))


def fault_of(quality: ImageQuality, blur_limit: float) -> str | None:
    """Return why a frame can't be a keyframe, `badly_exposed` or `blurred`, or None when it can."""
    if quality.is_poor:
        return "badly_exposed"
    return "blurred" if quality.sharpness < blur_limit else None


def find_replacements(
    wanted: Sequence[int],
    usable: Sequence[int],
    poses: Sequence[Pose],
    thresholds: PoseThresholds,
    is_good: Callable[[int], bool],
) -> dict[int, int]:
    """Return the frame that takes the place of each unusable keyframe, where there is one.

    It is the nearest good frame within the thresholds, by the larger of both differences as a share of its
    threshold and then by time. A place that another keyframe is close to, in both respects, needs none.
    """
    kept, taken, replaced = list(usable), set(wanted), dict[int, int]()
    for row in sorted(set(wanted) - set(usable)):
        if any(_nearness(poses[row], poses[other], thresholds) < 1.0 for other in kept):
            continue
        nearness = {
            other: _nearness(poses[row], poses[other], thresholds)
            for other in range(len(poses))
            if other not in taken
        }
        near = [other for other in nearness if nearness[other] < 1.0]
        near.sort(key=lambda other, row=row, nearness=nearness: (nearness[other], abs(other - row)))  # type: ignore[misc]
        found = next((other for other in near[:MAX_TRIED] if is_good(other)), None)
        if found is not None:
            replaced[row] = found
            kept.append(found)
            taken.add(found)
    return replaced


def _nearness(a: Pose, b: Pose, thresholds: PoseThresholds) -> float:
    """Return the larger of the differences in position and attitude, each as a share of its threshold."""
    return max(
        position_difference_m(a, b) / thresholds.position_m,
        attitude_difference_rad(a, b) / thresholds.attitude_rad,
    )
