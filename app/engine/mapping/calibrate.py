"""Calibration: how many matches are left at which pose difference, on a venue's own scan (A 2.1, eq. 1-3)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.calibration_curves import (
    MIN_ATTITUDE_RAD,
    MIN_POSITION_M,
    Calibration,
    PairCounts,
    fit_curves,
)
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.maps.points import GATE_PX
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose
from app.importers.frames import FrameSource
from app.vision.features import LocalFeatureExtractor
from app.vision.images import to_gray
from app.vision.matching import Unit, match_unit_vectors, to_unit_vectors

# Frames that many others are compared with, and all frames that are looked at: about 10 s of one core.
REFERENCES, FRAMES, PAIRS = 40, 200, 1500
# Frames further apart than these share nothing that a threshold could depend on.
MAX_POSITION_M, MAX_ATTITUDE_RAD = 5.0, 1.2
# Cells for spreading pairs evenly, per octave of either difference.
CELLS_PER_OCTAVE = 2
# Leaving out this share of frames leaves out about 30 % of pairs.
HELD_BACK_FRAMES = 0.163


@dataclass(frozen=True, slots=True)
class _Sight:
    """What a frame sees: keypoints (n, 2), unit descriptors (n, d), points in the scan (n, 3), NaN without depth."""

    scan_from_camera: Pose
    keypoints_px: NDArray[np.float32]
    descriptors: Unit
    points_in_scan: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Differences:
    """Pairs (n,) of rows with their differences."""

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    position_m: NDArray[np.float64]
    attitude_rad: NDArray[np.float64]

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> _Differences:
        return _Differences(
            self.first[rows], self.second[rows], self.position_m[rows], self.attitude_rad[rows]
        )

    def __len__(self) -> int:
        return len(self.first)


def calibrate(
    source: FrameSource,
    options: BuildOptions,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    wanted_matches: float | None = None,
    seed: int = 0,
) -> Calibration:
    """Fit matches over pose difference to a scan's own frames and derive its keyframe thresholds.

    At most `FRAMES` frames are described with the features of the options, chosen by `seed` so that their pairs
    cover small and large differences alike; matches of a pair count when depth and poses confirm them. About
    30 % of the pairs, all those of some frames, are held back for validation. `wanted_matches` is T_match,
    default what the options say. Raises `InvalidScanError` when the scan has too little to fit a curve to.
    """
    rng = np.random.default_rng(seed)
    poses = [frame.scan_from_camera for frame in source.frames]
    pairs = _choose_pairs(poses, rng)
    rows = np.unique(np.concatenate([pairs.first, pairs.second]))
    if len(rows) == 0:
        raise InvalidScanError(
            "The scan has no two frames that are near each other but not in the same place: a calibration needs "
            "frames of a moving camera."
        )
    extractor = models.extractor(options.features)

    def describe(row: int) -> _Sight:
        return _describe(source, row, extractor)

    order = [int(row) for row in rows]
    sights = dict(zip(order, map_in_order(executor, describe, order, "calibrate", progress), strict=True))

    def count(pair: tuple[int, int]) -> int:
        return _count_confirmed(sights[pair[0]], sights[pair[1]], source.camera, extractor)

    couples = [(int(i), int(j)) for i, j in zip(pairs.first, pairs.second, strict=True)]
    matches = np.array(list(map_in_order(executor, count, couples, "match pairs", progress)), dtype=np.int64)
    held = rng.choice(rows, round(HELD_BACK_FRAMES * len(rows)), replace=False)
    held_back = np.isin(pairs.first, held) | np.isin(pairs.second, held)
    counts = PairCounts(pairs.position_m, pairs.attitude_rad, matches, held_back)
    wanted = options.keyframes.wanted_matches if wanted_matches is None else wanted_matches
    return fit_curves(counts, wanted, options.features, len(rows))


def _choose_pairs(poses: Sequence[Pose], rng: np.random.Generator) -> _Differences:
    """Return pairs of at most `FRAMES` frames: references along the scan and frames at all differences to them."""
    references = np.unique(
        np.linspace(0, len(poses) - 1, min(REFERENCES, len(poses))).round().astype(np.intp)
    )
    near = _spread(_near_pairs(poses, references, np.arange(len(poses))), FRAMES, rng)
    partners = np.setdiff1d(near.second, references)
    rng.shuffle(partners)
    rows = np.sort(np.concatenate([references, partners[: FRAMES - len(references)]]))
    return _spread(_near_pairs(poses, rows, rows), PAIRS, rng)


def _near_pairs(poses: Sequence[Pose], first: NDArray[np.intp], second: NDArray[np.intp]) -> _Differences:
    """Return the pairs of a row of `first` and one of `second` that differ, but not by too much."""
    positions = np.stack([pose.translation for pose in poses])
    rotations = np.stack([pose.rotation for pose in poses])
    found = []
    for row in first:
        position_m = np.linalg.norm(positions[second] - positions[row], axis=1)
        traces = np.einsum("nij,ij->n", rotations[second], rotations[row])
        attitude_rad = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
        differ = (position_m >= MIN_POSITION_M) | (attitude_rad >= MIN_ATTITUDE_RAD)
        near = (position_m <= MAX_POSITION_M) & (attitude_rad <= MAX_ATTITUDE_RAD)
        # Each pair once: within one set of rows it would be found from both sides.
        once = (second > row) | ~np.isin(second, first)
        keep = np.flatnonzero(differ & near & once & (second != row))
        found.append(
            _Differences(np.full(len(keep), row), second[keep], position_m[keep], attitude_rad[keep])
        )
    return _Differences(
        *(np.concatenate([getattr(part, name) for part in found]) for name in _Differences.__slots__)
    )


def _spread(pairs: _Differences, count: int, rng: np.random.Generator) -> _Differences:
    """Return at most `count` pairs, spread evenly over octaves of both differences.

    Pairs fall into cells; the first ones drawn of every cell come before the second ones of any.
    """
    if len(pairs) <= count:
        return pairs
    columns = [
        np.floor(CELLS_PER_OCTAVE * np.log2(np.maximum(values / smallest, 0.5))).astype(np.int64)
        for values, smallest in ((pairs.position_m, MIN_POSITION_M), (pairs.attitude_rad, MIN_ATTITUDE_RAD))
    ]
    cells = columns[0] * 1000 + columns[1]
    shuffled = rng.permutation(len(pairs))
    by_cell = shuffled[np.argsort(cells[shuffled], kind="stable")]
    _, starts, sizes = np.unique(cells[by_cell], return_index=True, return_counts=True)
    rank = np.arange(len(pairs)) - np.repeat(starts, sizes)
    drawn = by_cell[np.argsort(rank, kind="stable")[:count]]
    return pairs.take(np.sort(drawn))


def _describe(source: FrameSource, row: int, extractor: LocalFeatureExtractor) -> _Sight:
    frame = source.frames[row]
    features = extractor.extract(to_gray(frame_rgb(source, frame)))
    depth_m = sample_depth(source.depth_m(frame), features.keypoints_px).astype(np.float64)
    depth_m[depth_m <= 0] = np.nan
    points = frame.scan_from_camera.apply(source.camera.unproject(features.keypoints_px, depth_m))
    descriptors = to_unit_vectors(features.descriptors, extractor.binary)
    return _Sight(frame.scan_from_camera, features.keypoints_px, descriptors, points)


def _count_confirmed(first: _Sight, second: _Sight, camera: Camera, extractor: LocalFeatureExtractor) -> int:
    """Return how many matches of two frames their depth and poses confirm.

    The gate is the one that points of a map are refined with: a scan's poses and its colour and depth cameras
    are off by a few pixels in places, while a false match is that near by chance once in seven hundred times.
    """
    ratio, binary = extractor.ratio, extractor.binary
    a, b, _ = match_unit_vectors(first.descriptors, second.descriptors, ratio, binary)
    if len(a) == 0:
        return 0
    errors = reprojection_errors_px(
        second.keypoints_px[b], first.points_in_scan[a], camera, second.scan_from_camera
    )
    return int((errors < GATE_PX * max(camera.width, camera.height) / 640.0).sum())
