"""Thinning of recordings that have more pictures a second than a map can use."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacingOptions:
    """How close in time the frames of a recording are kept."""

    min_step_s: float = limit(
        0.05,
        "Frames of a video that follow the last one that was kept by less than this are left out.",
        chosen="By hand: 20 a second; at walking speed they are 5 cm apart, keyframes 18 cm.",
    )


OPTIONS = SpacingOptions()
# Times are printed with a few digits.
_ROUNDING_S = 1e-3


def spaced_rows(times_s: Iterable[float]) -> list[int]:
    """Return the rows of ascending times that are kept: the first one, and each far enough from the last kept one."""
    kept: list[int] = []
    last_s = float("-inf")
    for row, time_s in enumerate(times_s):
        if time_s - last_s >= OPTIONS.min_step_s - _ROUNDING_S:
            kept.append(row)
            last_s = time_s
    return kept
