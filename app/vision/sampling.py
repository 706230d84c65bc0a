"""Choice of keyframes at constant intervals: every d metres, or every n-th frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingOptions:
    """The tolerance of a distance."""

    rounding_m: float = limit(
        1e-6,
        "A distance is reached when it is less than the wanted one by at most this.",
        chosen="By hand: steps of equal length add up to the distance except for rounding.",
    )


OPTIONS = SamplingOptions()


def select_by_distance(positions: ArrayLike, every_m: float) -> list[int]:
    """Return the frames of a walk that become keyframes: each one `every_m` or more from the keyframe before it.

    `positions` (n, 3) are those of the camera, in metres and in order; the first frame joins. Source: B eq. 1.
    """
    points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    chosen: list[int] = []
    for i, point in enumerate(points):
        if not chosen or np.linalg.norm(point - points[chosen[-1]]) >= every_m - OPTIONS.rounding_m:
            chosen.append(i)
    return chosen


def select_by_interval(frames: Sequence[object], every: int) -> list[int]:
    """Return every n-th frame, beginning with the first (B section 2.1, sampling of a video stream)."""
    return list(range(0, len(frames), every))
