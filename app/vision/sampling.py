"""Choice of keyframes that looks neither at attitude nor at content: every d metres, or every n-th frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

# A walk of even steps meets its distance to rounding only.
ROUNDING_M = 1e-6


def select_by_distance(positions: ArrayLike, every_m: float) -> list[int]:
    """Return the frames of a walk that become keyframes: each one `every_m` or more from the keyframe before it.

    `positions` (n, 3) are the camera's, in metres, in order; the first frame joins. Source: B eq. 1.
    """
    places = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    chosen: list[int] = []
    for i, place in enumerate(places):
        if not chosen or np.linalg.norm(place - places[chosen[-1]]) >= every_m - ROUNDING_M:
            chosen.append(i)
    return chosen


def select_by_interval(frames: Sequence[object], every: int) -> list[int]:
    """Return every n-th frame, beginning with the first (B section 2.1, sampling of a video stream)."""
    return list(range(0, len(frames), every))
