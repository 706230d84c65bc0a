"""Whether the poses hold together: across sudden steps of the trajectory, and between frames far apart in time.

The usual error of frames a little apart shows neither: each part of a scan agrees with itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.agreement import Rays, group_medians, relative_poses
from app.engine.mapping.examination.depth_ratio import measure_depth_ratio
from app.engine.mapping.examination.evidence import Evidence, FrameMatcher, compare_pairs
from app.engine.mapping.examination.outcome import Finding
from app.geometry.camera import REFERENCE_FOCAL_PX, Camera
from app.geometry.se3 import rotation_angle_deg, vector_from_rotation
from app.importers.conventions import PoseArrays
from app.limits import limit

Array = NDArray[np.float64]
_BY_TRIAL = (
    "By hand: right parts of RedKitchen, freiburg1_rpy, desk_rs and the demonstration scan have no such step and at "
    "most half of this error between far frames; `roomfix examine-mistakes` makes these mistakes."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencyOptions:
    """Which pairs are compared, and how far apart their poses may put one point."""

    step_ratio: float = limit(
        4.0,
        "A step is sudden when it differs from those beside it by this many times what steps usually do.",
        chosen="By hand: people walk evenly, and few steps have to be compared.",
    )
    least_step_m: float = limit(
        0.05,
        "And by this length more.",
        chosen="By hand: smaller jumps don't spoil a map.",
    )
    least_step_deg: float = limit(
        3.0,
        "The same for the turn of a step.",
        chosen="By hand: smaller jumps don't spoil a map.",
    )
    most_steps: int = limit(
        6, "Sudden steps that are compared, the largest first.", chosen="By hand: for speed."
    )
    most_far_pairs: int = limit(
        8, "Pairs of frames far apart in time that are compared.", chosen="By hand: for speed."
    )
    far_share: float = limit(
        0.2, "Share of a scan's frames that lies between two that are far apart.", chosen="By hand."
    )
    near_m: float = limit(
        0.7,
        "The poses put frames that are far apart in time this near.",
        chosen="By hand: half the view is shared.",
    )
    near_deg: float = limit(25.0, "The same for the turn between them.", chosen="By hand: half a view.")
    min_matches: int = limit(
        12, "Matches with depth that show where a pair's points are.", chosen="By hand: half of a pair's."
    )
    allowed_m: float = limit(
        0.06,
        "Distance between one point by both frames of a pair that no scan is blamed for.",
        chosen=_BY_TRIAL,
    )
    allowed_ratio: float = limit(0.03, "Part of the depth that is added to it.", chosen=_BY_TRIAL)
    wrong_ratio: float = limit(
        3.0,
        "A scan is refused from this many times the allowed distance on.",
        chosen="By hand: a third of a metre.",
    )
    still_px: float = limit(
        0.02,
        "Pictures whose matches move by less than this, at the focal length of reference, are one picture.",
        chosen="By hand: two pictures of a still camera differ by a tenth of a pixel.",
    )
    repeated_share: float = limit(
        0.1,
        "Share of pairs that are one picture at two poses, from which on a scan is refused.",
        chosen="By hand.",
    )


OPTIONS = ConsistencyOptions()
# What closing loops may mend.
DRIFT = "poses_drift"


def judge_consistency(
    frames: FrameMatcher, evidence: Evidence, camera: Camera, poses: PoseArrays
) -> list[Finding]:
    """Return what is wrong with poses (n) that agree with the pictures between most neighbouring frames."""
    ratio = measure_depth_ratio(evidence, Rays.of(evidence, camera), poses)
    scaled = PoseArrays(poses.rotations, poses.positions / (1.0 if ratio is None else ratio.ratio))
    found = (
        _repeated(evidence, scaled),
        _jumps(frames, camera, scaled),
        _drift(frames, camera, scaled),
    )
    return [finding for finding in found if finding is not None]


def _repeated(evidence: Evidence, poses: PoseArrays) -> Finding | None:
    moved_px = np.linalg.norm(evidence.first_px - evidence.second_px, axis=1)
    relative = relative_poses(evidence, poses)
    turned_rad = np.radians([rotation_angle_deg(rotation) for rotation in relative.rotations])
    by_poses_px = (turned_rad + np.linalg.norm(relative.positions, axis=1)) * REFERENCE_FOCAL_PX
    seen_px = group_medians(moved_px, evidence.pair, evidence.pairs)
    repeated = (seen_px < OPTIONS.still_px) & (by_poses_px > 1.0)
    if np.mean(repeated) < OPTIONS.repeated_share or np.count_nonzero(repeated) < 2:
        return None
    return Finding(
        code="pictures_repeat",
        sentence=f"The same picture is listed at different poses, in {np.count_nonzero(repeated)} of {evidence.pairs} "
        "places that were compared: list each picture once, at the time at which it was taken.",
        figures={"repeated_share": round(float(np.mean(repeated)), 3)},
    )


def _jumps(frames: FrameMatcher, camera: Camera, poses: PoseArrays) -> Finding | None:
    pairs = [(row, row + 1) for row in _sudden_steps(poses)]
    errors = _misplaced(frames, pairs, camera, poses)
    wrong = {pair: error for pair, error in errors.items() if error[0] > error[1]}
    if not wrong:
        return None
    (row, _), (error_m, allowed_m) = max(wrong.items(), key=lambda one: one[1][0] / one[1][1])
    name = frames.source.frames[row + 1].name
    return Finding(
        code="poses_jump",
        severity="wrong" if error_m > OPTIONS.wrong_ratio * allowed_m else "doubtful",
        sentence=f"The poses jump by {error_m:.2g} m where the pictures don't, before the picture {name}"
        f"{f' and in {len(wrong) - 1} more places' if len(wrong) > 1 else ''}: are the poses from several sessions "
        "or in several units, or did the tracking start anew? Give each part as a scan of its own.",
        figures={"jumps": len(wrong), "jump_m": round(error_m, 3)},
    )


def _drift(frames: FrameMatcher, camera: Camera, poses: PoseArrays) -> Finding | None:
    errors = _misplaced(frames, list(_far_pairs(frames.rows, poses)), camera, poses)
    if len(errors) < 2:
        return None
    off_m, allowed_m = (float(value) for value in np.median(np.array(list(errors.values())), axis=0))
    if off_m <= allowed_m:
        return None
    return Finding(
        code=DRIFT,
        severity="wrong" if off_m > OPTIONS.wrong_ratio * allowed_m else "doubtful",
        sentence=f"The poses drift: frames far apart in time that see the same place put it {off_m:.2g} m apart "
        f"(median of {len(errors)} pairs), so that one place has two. A build corrects that where the scan's own loops "
        "show how; else close loops in the tracking, or give the scan in parts.",
        figures={"drift_m": round(off_m, 3), "far_pairs": len(errors)},
    )


def _sudden_steps(poses: PoseArrays) -> list[int]:
    """Return the rows whose step to the next frame differs suddenly from the steps beside it, the largest first."""
    turns = poses.rotations[:-1].transpose(0, 2, 1) @ poses.rotations[1:]
    turns_deg = np.degrees([vector_from_rotation(turn) for turn in turns])
    by_step = _changes(np.diff(poses.positions, axis=0), OPTIONS.least_step_m)
    size = np.maximum(by_step, _changes(turns_deg, OPTIONS.least_step_deg))
    order = np.argsort(-size, kind="stable")[: OPTIONS.most_steps]
    return [int(row) for row in order if size[row] > 1.0]


def _changes(steps: Array, least: float) -> Array:
    """Return how steps (n, 3) differ from the mean of those beside them, over what is no sudden step (n,)."""
    padded = np.concatenate([steps[:1], steps, steps[-1:]])
    change = np.linalg.norm(steps - 0.5 * (padded[:-2] + padded[2:]), axis=1)
    return np.asarray(change / (least + OPTIONS.step_ratio * np.median(change)))


def _far_pairs(rows: list[int], poses: PoseArrays) -> Iterator[tuple[int, int]]:
    """Yield pairs of frames, among some rows, that are far apart in time and near by their poses, the nearest first.

    Each frame is in one of them at most.
    """
    apart = OPTIONS.far_share * len(poses.positions)
    near: list[tuple[float, int, int]] = []
    for first, second in combinations(rows, 2):
        if second - first < apart:
            continue
        step_m = float(np.linalg.norm(poses.positions[first] - poses.positions[second]))
        turn_deg = rotation_angle_deg(poses.rotations[first].T @ poses.rotations[second])
        distance = max(step_m / OPTIONS.near_m, turn_deg / OPTIONS.near_deg)
        if distance < 1.0:
            near.append((distance, first, second))
    used: set[int] = set()
    for _, first, second in sorted(near):
        if used & {first, second} or len(used) >= 2 * OPTIONS.most_far_pairs:
            continue
        used |= {first, second}
        yield first, second


def _misplaced(
    frames: FrameMatcher, pairs: list[tuple[int, int]], camera: Camera, poses: PoseArrays
) -> dict[tuple[int, int], tuple[float, float]]:
    """Return how far apart the frames of pairs put their matched points (median), and how far they may, in metres.

    Pairs that share too little are left out.
    """
    evidence = compare_pairs(frames, pairs)
    relative, rays = relative_poses(evidence, poses), Rays.of(evidence, camera)
    pair = evidence.pair
    points = rays.first * evidence.first_m[:, None]
    moved = np.einsum("mij,mj->mi", relative.rotations[pair], points) + relative.positions[pair]
    ahead = np.maximum(moved[:, 2], 0.1)
    across = np.linalg.norm(moved[:, :2] - rays.second[:, :2] * ahead[:, None], axis=1)
    along = np.where(evidence.second_m > 0, ahead - evidence.second_m, 0.0)
    off_m = np.hypot(across, along)
    found = {}
    for number in range(evidence.pairs):
        known = (pair == number) & (evidence.first_m > 0)
        if np.count_nonzero(known) >= OPTIONS.min_matches:
            depth_m = float(np.median(evidence.first_m[known]))
            allowed_m = OPTIONS.allowed_m + OPTIONS.allowed_ratio * depth_m
            place = int(evidence.first[number]), int(evidence.second[number])
            found[place] = float(np.median(off_m[known])), allowed_m
    return found
