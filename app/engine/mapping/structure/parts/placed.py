"""Pictures of no part, localized in the points of one where the time to the pictures beside them allows it."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts.localized import PartPoints, partners_of
from app.engine.mapping.structure.parts.pace import may_follow, usual_speed
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedOptions:
    """Which pictures are localized in a part that they don't belong to."""

    max_gap_s: float = limit(
        3.0,
        "Longest time from a picture to the nearest one whose pose is known.",
        chosen="By hand: what a person walks meanwhile is less than the distance of places that look alike.",
    )


OPTIONS = PlacedOptions()


def with_placed(part: Reconstruction, matched: MatchedPictures, times_s: Sequence[float]) -> Reconstruction:
    """Return the part with those other pictures that see enough of its points, and what they see of them.

    Those nearest in time to a known one come first. A pose counts where the camera could get there from the pictures
    before and after it in the time between them; `times_s` are the times of all pictures.
    """
    points, partners = PartPoints.of(part, matched), partners_of(matched.matches)
    speed = usual_speed(part.poses, times_s)
    poses = dict(part.poses)
    seen = {
        row: sighting
        for row in range(len(matched.features))
        if row not in poses and (sighting := points.localize(row, matched, partners)) is not None
    }
    observations = [part.observations]
    while seen:
        known = sorted(poses)
        gap_s, row = min((_gap_s(row, known, times_s), row) for row in seen)
        if gap_s > OPTIONS.max_gap_s:
            break
        own = seen.pop(row)
        if all(
            may_follow(own.pose, poses[other], abs(times_s[row] - times_s[other]), speed, points.median_depth)
            for other in _beside(row, known)
        ):
            poses[row] = own.pose
            rows = np.full(len(own.features), row)
            observations.append(np.stack([rows, own.features, own.points], axis=1))
    return replace(part, poses=dict(sorted(poses.items())), observations=np.concatenate(observations))


def _beside(row: int, known: Sequence[int]) -> list[int]:
    """Return the known rows before and after one."""
    at = bisect(known, row)
    return [*known[max(0, at - 1) : at], *known[at : at + 1]]


def _gap_s(row: int, known: Sequence[int], times_s: Sequence[float]) -> float:
    return min(abs(times_s[row] - times_s[other]) for other in _beside(row, known))
