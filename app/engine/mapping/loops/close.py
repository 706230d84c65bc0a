"""Loop closure of a scan whose positions drift, applied only where loops that were held back confirm it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.loops.find import Places
from app.engine.mapping.loops.optimize import Loop, loop_errors_m, optimized
from app.engine.mapping.loops.places import (
    Pair,
    choose_places,
    drift_m,
    drift_rad,
    may_be_near,
    ties_of,
    ways_m,
)
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.geometry.alignment import average_poses
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.importers.frames import Scan
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureOptions:
    """When a correction is applied."""

    max_error_m: float = limit(
        0.3,
        "Largest error of a loop's position, and largest bend of the path by a correction, beside the drift that is "
        "looked for.",
        chosen="By hand: places that look alike are further apart.",
    )
    max_error_rad: float = limit(0.1, "The same of the attitude.", chosen="By hand: six degrees.")
    block: int = limit(
        3,
        "Frames that take part of one stretch; loops between the same two stretches are held back together.",
        chosen="By hand: neighbouring loops measure nearly the same.",
    )
    held_every: int = limit(
        3,
        "Of this many groups of loops one is held back.",
        chosen="By hand: most are used, enough judge.",
    )
    min_held: int = limit(
        4,
        "Least number of loops that are held back, and of groups of those.",
        chosen="By hand: for a median.",
    )
    min_error_m: float = limit(
        0.03,
        "Least median error of the held-back loops before the correction for which it is applied.",
        chosen="By hand: twice what depth and lens make of right poses, 0.016 m on redkitchen and 0.015 m on "
        "freiburg1_rpy (`roomfix evaluate-drift SCAN --drift 0`).",
    )
    max_left_ratio: float = limit(
        0.6,
        "Largest ratio of the held-back loops' median error after to that before for which the correction is applied.",
        chosen="By hand: what only follows noise leaves nearly all of it.",
    )


OPTIONS = ClosureOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedLoops:
    """A scan, corrected where that is `is_applied`, and the figures of it.

    `compared` pairs of frames gave `loops`, of which some were `held` back. `before_m` and `after_m` are the median
    errors in metres of those, before and after the others corrected the path; None where there are too few. `moved_m`
    is by how far a frame moves at most. `is_fold` says that a correction was not applied since it would lay parts that
    look alike over each other.
    """

    scan: Scan
    compared: int
    loops: int
    held: int = 0
    before_m: float | None = None
    after_m: float | None = None
    moved_m: float = 0.0
    is_applied: bool = False
    is_fold: bool = False

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to say of a correction."""
        if self.is_fold and self.before_m is not None:
            return (
                f"Parts of the scan look alike, {self.before_m:.2f} m apart (median), as floors or corridors of one "
                "building do. They are kept apart, as the poses have them. If they are one place that was passed "
                "twice, the tracker lost its way between: scan that part again.",
            )
        if not self.is_applied or self.before_m is None or self.after_m is None:
            return ()
        return (
            f"The scan's positions drift: where it passes a place again it was {self.before_m:.2f} m off (median), "
            f"after a correction by its own loops {self.after_m:.2f} m. Frames moved by up to {self.moved_m:.2f} m.",
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for a report."""
        return {
            "compared": self.compared,
            "found": self.loops,
            "held_back": self.held,
            "before_m": None if self.before_m is None else round(self.before_m, 4),
            "after_m": None if self.after_m is None else round(self.after_m, 4),
            "applied": self.is_applied,
            "fold": self.is_fold,
            "moved_m": round(self.moved_m, 3),
        }


def close_loops(scan: Scan, models: VisionModels, executor: Executor, progress: Progress) -> ClosedLoops:
    """Return the scan with the drift of its positions corrected by loops, or as it is.

    A loop is a pair of frames far apart on the way that see the same place by features and depth of both. The path is
    corrected by some of them, and the correction is applied (by all of them) only where it lowers the errors of those
    that were held back. The first frame's pose stays.
    """
    poses = [frame.scan_from_camera for frame in scan.frames]
    way = ways_m(poses)
    rows = choose_places(way)
    path = [poses[row] for row in rows]
    near = may_be_near(path, way[rows])
    if not scan.has_depth or not near.any():
        return ClosedLoops(scan=scan, compared=0, loops=0)
    places = Places(
        scan=scan,
        frames=[scan.frames[row] for row in rows],
        models=models,
        executor=executor,
        progress=progress,
    )
    pairs = places.alike(near)
    loops = [loop for loop in places.motions(pairs) if is_drift(loop, path, way[rows])]
    used, held = held_back(loops)
    found = ClosedLoops(scan=scan, compared=len(pairs), loops=len(loops), held=len(held))
    if not held:
        return found
    progress.report("close_loops", 0, 1)
    before = float(np.median(loop_errors_m(path, held)))
    if before < OPTIONS.min_error_m:
        return replace(found, before_m=before)
    ties = places.motions(ties_of(path))
    after = float(np.median(loop_errors_m(optimized(path, [*used, *ties]), held)))
    found = replace(found, before_m=before, after_m=after)
    if after > OPTIONS.max_left_ratio * before:
        return found
    corrected = optimized(path, [*loops, *ties])
    if bend_m(path, corrected, way[rows]) > OPTIONS.max_error_m:
        return replace(found, is_fold=True)
    return _corrected(found, spread_over(poses, way, rows, corrected))


def _corrected(found: ClosedLoops, poses: Sequence[Pose]) -> ClosedLoops:
    frames = found.scan.frames
    moved = tuple(replace(frame, scan_from_camera=pose) for frame, pose in zip(frames, poses, strict=True))
    far = max(position_difference_m(a.scan_from_camera, b) for a, b in zip(frames, poses, strict=True))
    return replace(found, scan=replace(found.scan, frames=moved), moved_m=far, is_applied=True)


def bend_m(path: Sequence[Pose], corrected: Sequence[Pose], way_m: Array) -> float:
    """Return by how much more than drift a correction changes the motion between two places, at most.

    Drift grows on the whole way. Where two parts of a scan look alike, as two floors of a building, all loops between
    them agree on a motion that lays one over the other: the correction leaves both parts as they are and bends the
    short way between them by metres.
    """
    most = 0.0
    for row in range(len(path) - 1):
        before, after = (_seen_from(poses, row) for poses in (path, corrected))
        changed = np.linalg.norm(after - before, axis=1)
        most = max(most, float((changed - drift_m(way_m[row + 1 :] - way_m[row])).max()))
    return most


def _seen_from(poses: Sequence[Pose], row: int) -> Array:
    """Return the positions (n, 3) of the poses after a row in the axes of that row's pose."""
    return poses[row].inverse().apply(np.stack([pose.translation for pose in poses[row + 1 :]]))


def is_drift(loop: Loop, poses: Sequence[Pose], way_m: Array) -> bool:
    """Return whether a loop's error may be drift; more is a place that looks alike."""
    way = way_m[loop.b] - way_m[loop.a]
    by_path = poses[loop.a].inverse() @ poses[loop.b]
    off_m = position_difference_m(by_path, loop.a_from_b)
    off_rad = attitude_difference_rad(by_path, loop.a_from_b)
    is_near = off_m <= OPTIONS.max_error_m + drift_m(way)
    return bool(is_near and off_rad <= OPTIONS.max_error_rad + drift_rad(way))


def held_back(loops: Sequence[Loop]) -> tuple[list[Loop], list[Loop]]:
    """Return the loops that are used and those that judge, no two of the same stretches on both sides; none of either
    where there are too few."""
    groups: dict[Pair, list[Loop]] = {}
    for loop in loops:
        groups.setdefault((loop.a // OPTIONS.block, loop.b // OPTIONS.block), []).append(loop)
    ordered = [groups[key] for key in sorted(groups)]
    held = [
        loop for number, group in enumerate(ordered) for loop in group if number % OPTIONS.held_every == 1
    ]
    used = [
        loop for number, group in enumerate(ordered) for loop in group if number % OPTIONS.held_every != 1
    ]
    few = len(ordered) // OPTIONS.held_every < OPTIONS.min_held or len(held) < OPTIONS.min_held
    return ([], []) if few else (used, held)


def spread_over(
    poses: Sequence[Pose], way_m: Array, rows: Sequence[int], places: Sequence[Pose]
) -> list[Pose]:
    """Return all poses, corrected as the two places (`rows`, whose corrected poses are given) before and after each."""
    corrections = [place @ poses[row].inverse() for row, place in zip(rows, places, strict=True)]
    found: list[Pose] = []
    for number, pose in enumerate(poses):
        after = min(int(np.searchsorted(rows, number)), len(rows) - 1)
        before = max(0, after - 1)
        length = way_m[rows[after]] - way_m[rows[before]]
        share = 1.0 if length == 0 else float((way_m[number] - way_m[rows[before]]) / length)
        both = [corrections[before] @ pose, corrections[after] @ pose]
        found.append(both[1] if share >= 1 else average_poses(both, [1 - share, share], robust=False))
    return found
