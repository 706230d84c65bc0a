"""Frames far apart on the way that see the same place: how far apart their poses are from what the pictures say."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.loops.close import is_drift
from app.engine.mapping.loops.measure import Seen, measure_motion
from app.engine.mapping.loops.optimize import Loop, loop_errors_m
from app.engine.mapping.loops.places import Pair, choose_places, may_be_near, ways_m
from app.engine.progress import Progress, map_in_order
from app.errors import InvalidScanError
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan
from app.limits import limit
from app.vision.images import to_gray
from app.vision.local_features import create_extractor

Array = NDArray[np.float64]
FEATURES = "sift"


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledLoopOptions:
    """How many pairs of frames are compared, whatever the length of the scan."""

    max_pairs: int = limit(
        24, "Pairs of frames that are compared.", chosen="By hand: an inspection stays one of seconds."
    )
    block: int = limit(
        5,
        "Frames that take part of one stretch; of two stretches one pair is compared.",
        chosen="By hand: neighbouring pairs say nearly the same.",
    )
    min_loops: int = limit(3, "Least number of loops for a median error.", chosen="By hand: for a median.")


OPTIONS = SampledLoopOptions()


@dataclass(frozen=True, slots=True)
class SampledLoops:
    """Of `compared` pairs of frames `found` see the same place; `error_m` is the median difference of their motion by
    the poses from that by pictures and depth, in metres, None for too few."""

    compared: int
    found: int
    error_m: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON, rounded."""
        error_m = None if self.error_m is None else round(self.error_m, 4)
        return {"compared": self.compared, "found": self.found, "error_m": error_m}


def sampled_loops(scan: Scan, executor: Executor, progress: Progress) -> SampledLoops | None:
    """Return what a few pairs of a scan's frames say of its drift; None for a scan without depth.

    Unlike `close_loops` it needs no global descriptor: the pairs are such whose poses are near each other.
    Pictures that can't be decoded are left out.
    """
    if not scan.has_depth:
        return None
    poses = [frame.scan_from_camera for frame in scan.frames]
    way_m = ways_m(poses)
    rows = choose_places(way_m)
    path = [poses[row] for row in rows]
    pairs = _nearest_pairs(path, way_m[rows], may_be_near(path, way_m[rows]))
    places = sorted({place for pair in pairs for place in pair})
    extractor = create_extractor(FEATURES)

    def seen_by(frame: Frame) -> Seen | None:
        try:
            features = extractor.extract(to_gray(frame_rgb(scan, frame)))
            return Seen(features, sample_depth(scan.depth_m(frame), features.keypoints_px).astype(np.float32))
        except InvalidScanError:
            return None

    frames = [scan.frames[rows[place]] for place in places]
    described = map_in_order(executor, seen_by, frames, "describe_places", progress)
    seen = dict(zip(places, described, strict=True))

    def measured(pair: Pair) -> Loop | None:
        a, b = (seen[place] for place in pair)
        motion = None if a is None or b is None else measure_motion(a, b, scan.camera, extractor.binary)
        return None if motion is None else Loop(*pair, motion)

    motions = map_in_order(executor, measured, pairs, "find_loops", progress)
    loops = [loop for loop in motions if loop is not None and is_drift(loop, path, way_m[rows])]
    enough = len(loops) >= OPTIONS.min_loops
    return SampledLoops(
        len(pairs), len(loops), float(np.median(loop_errors_m(path, loops))) if enough else None
    )


def _nearest_pairs(path: Sequence[Pose], way_m: Array, near: NDArray[np.bool_]) -> list[Pair]:
    """Return pairs (i < j) of a mask (n, n) whose poses are nearest by metres and radians between them, added.

    One pair for two stretches of the path, and half of them after the longer ways, where more has drifted.
    """
    first, second = np.nonzero(np.triu(near))
    positions = np.stack([pose.translation for pose in path])
    forward = np.stack([pose.rotation[:, 2] for pose in path])
    cosines = np.clip((forward[first] * forward[second]).sum(axis=1), -1.0, 1.0)
    apart = np.linalg.norm(positions[first] - positions[second], axis=1) + np.arccos(cosines)
    between_m = way_m[second] - way_m[first]
    is_long = between_m > np.median(between_m) if len(between_m) else np.zeros(0, bool)
    chosen: dict[Pair, Pair] = {}
    for part, most in ((is_long, OPTIONS.max_pairs // 2), (~is_long, OPTIONS.max_pairs)):
        rows = np.flatnonzero(part)
        for row in rows[np.argsort(apart[rows], kind="stable")].tolist():
            if len(chosen) == most:
                break
            pair = int(first[row]), int(second[row])
            chosen.setdefault((pair[0] // OPTIONS.block, pair[1] // OPTIONS.block), pair)
    return sorted(chosen.values())
