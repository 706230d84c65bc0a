"""Calibration: the number of matches as a function of pose difference, on a venue's own scan (A 2.1, eq. 1-3)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.calibration_curves import OPTIONS as CURVE_OPTIONS
from app.engine.mapping.calibration_curves import Calibration, PairCounts, fit_curves
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.maps.points import OPTIONS as POINT_OPTIONS
from app.engine.maps.points import scaled_px
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose
from app.importers.frames import FrameSource
from app.limits import limit
from app.vision.features import LocalFeatureExtractor
from app.vision.images import to_gray
from app.vision.matching import Unit, match_unit_vectors, to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleOptions:
    """Which pairs of a scan's frames are compared."""

    reference_frames: int = limit(
        40,
        "Frames, evenly spread along the scan, that the other frames are compared with.",
        chosen="By hand: with `frames` and `pairs`, a calibration takes about 10 s of one core.",
    )
    frames: int = limit(
        200,
        "Largest number of frames that are described.",
        chosen="By hand: with `reference_frames` and `pairs`, a calibration takes about 10 s of one core.",
    )
    pairs: int = limit(
        1500,
        "Largest number of pairs of frames that are matched.",
        chosen="By hand: with `reference_frames` and `frames`, a calibration takes about 10 s of one core.",
    )
    max_position_m: float = limit(
        5.0,
        "Largest position difference of a pair.",
        chosen="By hand: frames further apart have too few matches for a threshold to depend on them.",
    )
    max_attitude_rad: float = limit(
        1.2,
        "Largest attitude difference of a pair.",
        chosen="By hand: frames further apart have too few matches for a threshold to depend on them.",
    )
    cells_per_octave: int = limit(
        2,
        "Cells for each doubling of a difference; pairs are drawn evenly from all cells.",
        chosen="By hand; no measurement is recorded.",
    )
    held_back_share: float = limit(
        0.163,
        "Fraction of the frames whose pairs are held back from the fit, for validation.",
        chosen="Computed: 1 - sqrt(0.7), about 0.163, leaves out about 30 % of the pairs.",
    )


OPTIONS = SampleOptions()


@dataclass(frozen=True, slots=True)
class _DescribedFrame:
    """A frame's keypoints (n, 2), unit descriptors (n, d), and points in the scan (n, 3), NaN without depth."""

    scan_from_camera: Pose
    keypoints_px: NDArray[np.float32]
    descriptors: Unit
    points_in_scan: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Differences:
    """Pairs (n,) of frames, by their rows, with the differences of their poses."""

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

    At most `OPTIONS.frames` frames are described with the features of the options. They are drawn with `seed` so
    that their pairs cover small and large differences evenly. A match counts when depth and poses confirm it. About
    30 % of the pairs, all those of some frames, are held back for validation. `wanted_matches` is T_match, by default
    that of the options. Raises `InvalidScanError` when the scan has too few pairs to fit a curve to.
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

    def describe(row: int) -> _DescribedFrame:
        return _describe(source, row, extractor)

    order = [int(row) for row in rows]
    described = dict(zip(order, map_in_order(executor, describe, order, "calibrate", progress), strict=True))

    def count(pair: tuple[int, int]) -> int:
        return _count_confirmed(described[pair[0]], described[pair[1]], source.camera, extractor)

    couples = [(int(i), int(j)) for i, j in zip(pairs.first, pairs.second, strict=True)]
    matches = np.array(list(map_in_order(executor, count, couples, "match pairs", progress)), dtype=np.int64)
    held = rng.choice(rows, round(OPTIONS.held_back_share * len(rows)), replace=False)
    held_back = np.isin(pairs.first, held) | np.isin(pairs.second, held)
    counts = PairCounts(pairs.position_m, pairs.attitude_rad, matches, held_back)
    wanted = options.keyframes.wanted_matches if wanted_matches is None else wanted_matches
    return fit_curves(counts, wanted, options.features, len(rows))


def _choose_pairs(poses: Sequence[Pose], rng: np.random.Generator) -> _Differences:
    """Return pairs of at most `OPTIONS.frames` frames: references along the scan, and others at all differences."""
    references = np.unique(
        np.linspace(0, len(poses) - 1, min(OPTIONS.reference_frames, len(poses))).round().astype(np.intp)
    )
    near = _spread(_near_pairs(poses, references, np.arange(len(poses))), OPTIONS.frames, rng)
    partners = np.setdiff1d(near.second, references)
    rng.shuffle(partners)
    rows = np.sort(np.concatenate([references, partners[: OPTIONS.frames - len(references)]]))
    return _spread(_near_pairs(poses, rows, rows), OPTIONS.pairs, rng)


def _near_pairs(poses: Sequence[Pose], first: NDArray[np.intp], second: NDArray[np.intp]) -> _Differences:
    """Return the pairs of a row of `first` and a row of `second` whose differences are within the options' limits."""
    positions = np.stack([pose.translation for pose in poses])
    rotations = np.stack([pose.rotation for pose in poses])
    found = []
    for row in first:
        position_m = np.linalg.norm(positions[second] - positions[row], axis=1)
        traces = np.einsum("nij,ij->n", rotations[second], rotations[row])
        attitude_rad = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
        differ = (position_m >= CURVE_OPTIONS.min_position_m) | (
            attitude_rad >= CURVE_OPTIONS.min_attitude_rad
        )
        near = (position_m <= OPTIONS.max_position_m) & (attitude_rad <= OPTIONS.max_attitude_rad)
        # Within one set of rows a pair would be found twice, once from each of its frames.
        once = (second > row) | ~np.isin(second, first)
        keep = np.flatnonzero(differ & near & once & (second != row))
        found.append(
            _Differences(np.full(len(keep), row), second[keep], position_m[keep], attitude_rad[keep])
        )
    return _Differences(
        first=np.concatenate([part.first for part in found]),
        second=np.concatenate([part.second for part in found]),
        position_m=np.concatenate([part.position_m for part in found]),
        attitude_rad=np.concatenate([part.attitude_rad for part in found]),
    )


def _spread(pairs: _Differences, count: int, rng: np.random.Generator) -> _Differences:
    """Return at most `count` pairs, spread evenly over octaves of both differences.

    Every pair belongs to a cell of both differences. One pair of each cell is drawn before a second one of any cell.
    """
    if len(pairs) <= count:
        return pairs
    columns = [
        np.floor(OPTIONS.cells_per_octave * np.log2(np.maximum(values / smallest, 0.5))).astype(np.int64)
        for values, smallest in (
            (pairs.position_m, CURVE_OPTIONS.min_position_m),
            (pairs.attitude_rad, CURVE_OPTIONS.min_attitude_rad),
        )
    ]
    cells = columns[0] * 1000 + columns[1]
    shuffled = rng.permutation(len(pairs))
    by_cell = shuffled[np.argsort(cells[shuffled], kind="stable")]
    _, starts, sizes = np.unique(cells[by_cell], return_index=True, return_counts=True)
    rank = np.arange(len(pairs)) - np.repeat(starts, sizes)
    drawn = by_cell[np.argsort(rank, kind="stable")[:count]]
    return pairs.take(np.sort(drawn))


def _describe(source: FrameSource, row: int, extractor: LocalFeatureExtractor) -> _DescribedFrame:
    frame = source.frames[row]
    features = extractor.extract(to_gray(frame_rgb(source, frame)))
    depth_m = sample_depth(source.depth_m(frame), features.keypoints_px).astype(np.float64)
    depth_m[depth_m <= 0] = np.nan
    points = frame.scan_from_camera.apply(source.camera.unproject(features.keypoints_px, depth_m))
    descriptors = to_unit_vectors(features.descriptors, extractor.binary)
    return _DescribedFrame(frame.scan_from_camera, features.keypoints_px, descriptors, points)


def _count_confirmed(
    first: _DescribedFrame, second: _DescribedFrame, camera: Camera, extractor: LocalFeatureExtractor
) -> int:
    """Return the number of matches of two frames that their depth and poses confirm.

    A match is confirmed within the match gate that points of a map are refined with.
    """
    ratio, binary = extractor.ratio, extractor.binary
    a, b, _ = match_unit_vectors(first.descriptors, second.descriptors, ratio, binary)
    if len(a) == 0:
        return 0
    errors = reprojection_errors_px(
        second.keypoints_px[b], first.points_in_scan[a], camera, second.scan_from_camera
    )
    return int((errors < scaled_px(POINT_OPTIONS.match_gate_px, camera)).sum())
