"""Where a video comes back to a place, judged by the path between: look-alike places that match are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.loops.close import is_drift
from app.engine.mapping.loops.measure import Seen, motion_of_matches
from app.engine.mapping.loops.optimize import Loop, loop_errors_m, optimized
from app.engine.mapping.loops.places import ways_m
from app.engine.mapping.structure.matches import MatchedPictures, Pair
from app.engine.mapping.structure.reconstruction import Reconstruction, median_depth
from app.engine.mapping.structure.scale import OPTIONS as SCALE
from app.engine.progress import Progress
from app.geometry.se3 import Pose
from app.limits import limit

STAGE = "find_loops"
REPORT_EVERY_PAIRS = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class RevisitOptions:
    """When two far-apart pictures of a video may tie its path together."""

    beside: int = limit(
        3,
        "Pictures after each one whose matches decide the path by themselves.",
        chosen="By hand, on the video of `roomfix evaluate-video` with its true poses: a floor that repeats itself "
        "made false pairs up to 8 apart, and none up to 3.",
    )
    max_left_m: float = limit(
        0.25,
        "Largest error of a loop after the path is corrected by all of them.",
        chosen="By hand: far below the distance of doors and corridors that look alike.",
    )


OPTIONS = RevisitOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Revisits:
    """What the far-apart pairs of pictures say: `poses` of the corrected path by picture, and the pairs that agree.

    `compared` pairs matched, `measured` gave a motion, `within_drift` of those can be of one place by the path between.
    """

    poses: dict[int, Pose]
    agreeing: tuple[Pair, ...]
    compared: int
    measured: int
    within_drift: int

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for a report."""
        return {
            "compared": self.compared,
            "measured": self.measured,
            "within_drift": self.within_drift,
            "agreeing": len(self.agreeing),
        }


def find_revisits(
    part: Reconstruction,
    matched: MatchedPictures,
    pairs: Sequence[Pair],
    progress: Progress,
) -> Revisits:
    """Return which of the matched `pairs` see one place twice, by a path (`part`) that was found without them.

    A place that looks like another one matches as well as the same place does, and its neighbours match alike: only the
    way between the two tells them apart, whose drift is bounded.
    """
    rows = sorted(part.poses)
    place = {row: number for number, row in enumerate(rows)}
    units = SCALE.own_depth / median_depth(part)
    path = [Pose(part.poses[row].rotation, units * part.poses[row].translation) for row in rows]
    seen = _seen(part, matched, units)
    way = ways_m(path)
    known = [pair for pair in pairs if pair[0] in place and pair[1] in place]
    loops: list[Loop] = []
    pair_of: list[Pair] = []
    measured = 0
    for number, (i, j) in enumerate(known):
        if number % REPORT_EVERY_PAIRS == 0:
            progress.report(STAGE, number, len(known))
        rows_i, rows_j = matched.matches[i, j].T
        motion = motion_of_matches(seen[i], rows_i, seen[j], rows_j, part.camera)
        measured += motion is not None
        if motion is None:
            continue
        loop = Loop(place[i], place[j], motion)
        if is_drift(loop, path, way):
            loops.append(loop)
            pair_of.append((i, j))
    corrected = optimized(path, loops)
    left = loop_errors_m(corrected, loops)
    return Revisits(
        poses={
            row: Pose(pose.rotation, pose.translation / units)
            for row, pose in zip(rows, corrected, strict=True)
        },
        agreeing=tuple(
            pair for pair, error in zip(pair_of, left, strict=True) if error <= OPTIONS.max_left_m
        ),
        compared=len(known),
        measured=measured,
        within_drift=len(loops),
    )


def _seen(part: Reconstruction, matched: MatchedPictures, units: float) -> dict[int, Seen]:
    """Return the features of each picture with the depth of those that have a point."""
    pictures, numbers, points = part.observations.T
    seen = {}
    for row, pose in part.poses.items():
        own = pictures == row
        depth: NDArray[np.float32] = np.zeros(len(matched.features[row].keypoints_px), np.float32)
        depth[numbers[own]] = units * pose.inverse().apply(part.points[points[own]])[:, 2]
        seen[row] = Seen(matched.features[row], np.maximum(depth, 0))
    return seen
