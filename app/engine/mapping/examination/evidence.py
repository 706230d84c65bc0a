"""What the pictures and depth images of a scan say by themselves: matches between frames a little apart."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.depth_shift import SmallPicture
from app.engine.mapping.examination.limits import LIMITS
from app.engine.mapping.frame_images import frame_rgb
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import REFERENCE_FOCAL_PX, Camera
from app.geometry.depth import sample_depth
from app.geometry.epipolar import (
    essential_from_pose,
    estimate_relative_pose,
    filter_by_fundamental_matrix,
)
from app.geometry.sampson import sampson_errors
from app.geometry.se3 import attitude_difference_rad, position_difference_m
from app.importers.frames import FrameSource
from app.limits import limit
from app.vision.images import to_gray
from app.vision.local_features import SIFT_SIDE_PX, RootSift
from app.vision.matching import Unit, match_unit_vectors, to_unit_vectors

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
DepthImage = NDArray[np.float32]
# To the right, left, down and up of a match.
ASIDE = ((1, 0), (-1, 0), (0, 1), (0, -1))
# Farther from the middle of the picture, or nearer to it: by both sides, by width, by height.
FIELDS = ((1.14, 1.14), (0.88, 0.88), (1.2, 1.0), (0.84, 1.0), (1.0, 1.2), (1.0, 0.84))


@dataclass(frozen=True, slots=True, kw_only=True)
class EvidenceOptions:
    """How pairs of frames are chosen and matched."""

    wanted_shift_px: float = limit(
        70.0,
        "The second pair of a place is so far apart that matches move by this, at the focal length of reference.",
        chosen="By hand: an eighth of a picture, where most of the view is still shared.",
    )
    max_gap: int = limit(
        40, "Frames between the two of a pair.", chosen="By hand: more than a second of video."
    )
    features: int = limit(
        800, "Local features of a frame.", chosen="By hand: enough for a hundred matches at half the time."
    )
    min_matches: int = limit(
        24,
        "Verified matches that make a pair count.",
        chosen="By hand: twice as many as wrong pairs reach by chance.",
    )
    verification_px: float = limit(
        2.0,
        "The largest epipolar error of a verified match, at the focal length of reference.",
        chosen="By hand: half as much again as a SIFT match is off at 640 pixels.",
    )
    near_m: float = limit(
        1.0,
        "Frames that the poses put this near are tried when neighbours in time share too little.",
        chosen="By hand: a step and a half.",
    )
    near_rad: float = limit(
        0.5, "The same for the turn between them.", chosen="By hand: half of a usual camera's view."
    )
    aside_ratio: float = limit(
        0.02,
        "Depth beside a match is sampled this part of the picture's longer side away.",
        chosen="By hand: 13 px of 640, between the least shift of depth that counts and the largest.",
    )


OPTIONS = EvidenceOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Matches of pairs of frames, verified by an epipolar geometry of their own, not by the scan's poses.

    `first` and `second` (p,) are rows of the scan's frames. `pair` (m,) says of which pair a match is, `first_px`
    and `second_px` (m, 2) where it is in both pictures, `first_m` and `second_m` (m,) the sensor's depth there, 0 where
    not known, `first_aside_m` and `second_aside_m` (m, 10) that beside it, in the directions of `ASIDE`, then that at
    positions multiplied by `FIELDS` about the middle of the picture. `noise_px`
    (p,) is the median error that a pair's matches leave under their own geometry and `motion_px` (p,) how far they move
    during `LIMITS.shutter_s`, both at the focal length of reference. `tried` counts the pairs that were compared.
    """

    first: Rows
    second: Rows
    pair: Rows
    first_px: Array
    second_px: Array
    first_m: Array
    second_m: Array
    first_aside_m: Array
    second_aside_m: Array
    noise_px: Array
    motion_px: Array
    tried: int

    @property
    def pairs(self) -> int:
        """The number of pairs with enough matches."""
        return len(self.first)

    @property
    def still_tolerance_px(self) -> Array:
        """The epipolar error (p,) that matches of a still camera may have, at the focal length of reference."""
        return LIMITS.noise_ratio * np.maximum(self.noise_px, LIMITS.min_noise_px)

    @property
    def tolerance_px(self) -> Array:
        """The epipolar error (p,) that a right scan may have, at the focal length of reference."""
        return np.asarray(np.hypot(self.still_tolerance_px, self.motion_px))

    def of_pairs(self, pairs: NDArray[np.bool_]) -> Evidence:
        """Return the evidence of some of the pairs (p,)."""
        return self._with_matches(pairs[self.pair], pairs)

    def thinned(self, matches: int) -> Evidence:
        """Return the evidence with at most so many matches of each pair, evenly chosen."""
        place = np.arange(len(self.pair)) - np.searchsorted(self.pair, self.pair)
        step = np.ceil(np.bincount(self.pair, minlength=self.pairs) / matches).astype(np.intp)
        return self._with_matches(
            place % np.maximum(step, 1)[self.pair] == 0, np.ones(self.pairs, dtype=bool)
        )

    def with_aside(self, direction: int) -> Evidence:
        """Return the evidence with the depth beside the matches, the n-th of `ASIDE` and `FIELDS`, for theirs."""
        return replace(
            self, first_m=self.first_aside_m[:, direction], second_m=self.second_aside_m[:, direction]
        )

    def _with_matches(self, matches: NDArray[np.bool_], pairs: NDArray[np.bool_]) -> Evidence:
        renumbered = np.cumsum(pairs) - 1
        return replace(
            self,
            first=self.first[pairs],
            second=self.second[pairs],
            pair=renumbered[self.pair[matches]],
            first_px=self.first_px[matches],
            second_px=self.second_px[matches],
            first_m=self.first_m[matches],
            second_m=self.second_m[matches],
            first_aside_m=self.first_aside_m[matches],
            second_aside_m=self.second_aside_m[matches],
            noise_px=self.noise_px[pairs],
            motion_px=self.motion_px[pairs],
        )


@dataclass(frozen=True, slots=True)
class _Seen:
    keypoints_px: Array
    units: Unit
    depth_m: Array
    aside_m: Array
    picture: SmallPicture


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pair:
    first: int
    second: int
    first_px: Array
    second_px: Array
    first_m: Array
    second_m: Array
    first_aside_m: Array
    second_aside_m: Array
    noise_px: float
    shift_px: float


class FrameMatcher:
    """Matches between frames of a scan; the features of each are found once."""

    def __init__(self, source: FrameSource, side_px: int = SIFT_SIDE_PX) -> None:
        """`side_px` is the length to which a picture's longer side is reduced for its features."""
        self.source = source
        self._extractor = RootSift(max_features=OPTIONS.features, max_side_px=side_px)
        self._seen: dict[int, _Seen] = {}
        self._lock = threading.Lock()

    def seen(self, row: int) -> _Seen:
        """Return the features of a frame and the depth at them."""
        with self._lock:
            known = self._seen.get(row)
        if known is not None:
            return known
        frame = self.source.frames[row]
        gray, depth_m = to_gray(frame_rgb(self.source, frame)), self.source.depth_m(frame)
        features = self._extractor.extract(gray)
        keypoints_px = features.keypoints_px.astype(np.float64)
        camera = self.source.camera
        places = [keypoints_px + px for px in aside_px(camera) * np.array(ASIDE)]
        places += [in_field(keypoints_px, camera, field) for field in FIELDS]
        found = _Seen(
            keypoints_px,
            to_unit_vectors(features.descriptors, self._extractor.binary),
            sample_depth(depth_m, keypoints_px).astype(np.float64),
            np.stack([sample_depth(depth_m, px) for px in places], axis=1).astype(np.float64),
            SmallPicture.of(gray, depth_m),
        )
        with self._lock:
            self._seen[row] = found
        return found

    @property
    def rows(self) -> list[int]:
        """The frames whose features are known."""
        return sorted(self._seen)

    def pictures(self, count: int) -> list[SmallPicture]:
        """Return small pictures of up to `count` of the frames that were compared, spread along the scan."""
        rows = sorted(self._seen)
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(int))
        return [self._seen[rows[i]].picture for i in chosen.tolist()]

    def pair(self, first: int, second: int) -> _Pair | None:
        """Return the verified matches of two frames, None when they are too few."""
        a, b = self.seen(first), self.seen(second)
        rows, others, _ = match_unit_vectors(a.units, b.units, self._extractor.ratio)
        if len(rows) < OPTIONS.min_matches:
            return None
        camera = self.source.camera
        scale = camera.focal_px / REFERENCE_FOCAL_PX
        # Through a lens that bends lines no one matrix fits a whole picture.
        flat_a, flat_b = (camera.undistort(px) for px in (a.keypoints_px[rows], b.keypoints_px[others]))
        kept = filter_by_fundamental_matrix(flat_a, flat_b, max_error_px=OPTIONS.verification_px * scale)
        rows, others = rows[kept], others[kept]
        if len(rows) < OPTIONS.min_matches:
            return None
        a_px, b_px = a.keypoints_px[rows], b.keypoints_px[others]
        return _Pair(
            first=first,
            second=second,
            first_px=a_px,
            second_px=b_px,
            first_m=a.depth_m[rows],
            second_m=b.depth_m[others],
            first_aside_m=a.aside_m[rows],
            second_aside_m=b.aside_m[others],
            noise_px=_own_error_px(a_px, b_px, camera),
            shift_px=float(np.median(np.linalg.norm(a_px - b_px, axis=1))) / scale,
        )


def gather_evidence(frames: FrameMatcher, places: int, executor: Executor, progress: Progress) -> Evidence:
    """Match pairs of frames at places spread along the scan.

    At each place the next frame, then one so far away that matches move by about 70 px; where the next one shares
    too little, the nearest one by the poses.
    """
    source = frames.source
    count = len(source.frames)
    last = max(count - 2, 0)
    starts = sorted({int(row) for row in np.linspace(0, last, places).round()}) if count > 1 else []

    def compare(start: int) -> list[_Pair | None]:
        near = frames.pair(start, start + 1)
        if near is None:
            beside = _nearest_by_pose(source, start)
            return [None] if beside is None else [None, frames.pair(start, beside)]
        gap = int(np.clip(round(OPTIONS.wanted_shift_px / max(near.shift_px, 1.0)), 2, OPTIONS.max_gap))
        far = start + gap if start + gap < count else start - gap
        return [near, frames.pair(start, far) if 0 <= far < count else None]

    found: dict[tuple[int, int], _Pair] = {}
    tried = 0
    for results in map_in_order(executor, compare, starts, "examine", progress):
        tried += len(results)
        found.update({(min(p.first, p.second), max(p.first, p.second)): p for p in results if p is not None})
    return _packed(list(found.values()), source, tried)


def compare_pairs(frames: FrameMatcher, pairs: Sequence[tuple[int, int]]) -> Evidence:
    """Return the matches of pairs of frames, without those that share too little."""
    found = [frames.pair(first, second) for first, second in pairs]
    return _packed([pair for pair in found if pair is not None], frames.source, len(pairs))


def aside_px(camera: Camera) -> float:
    """Return how far beside a match depth is sampled."""
    return OPTIONS.aside_ratio * max(camera.width, camera.height)


def in_field(pixels: Array, camera: Camera, ratios: tuple[float, float]) -> Array:
    """Return pixels (n, 2) whose distances from the middle of the picture are multiplied, to the side and down."""
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    return np.asarray(middle + (pixels - middle) * np.array(ratios))


def with_depth(
    evidence: Evidence,
    depth_of: Callable[[int], DepthImage],
    sampled_at: Callable[[Array], Array] = lambda px: px,
) -> Evidence:
    """Return the evidence with other depth images for the frames (rows), sampled at positions (n, 2) in pixels that
    `sampled_at` makes from those of the matches."""
    first_m, second_m = np.zeros(len(evidence.pair)), np.zeros(len(evidence.pair))
    bounds = np.searchsorted(evidence.pair, np.arange(evidence.pairs + 1))
    depth = {int(row): depth_of(int(row)) for row in {*evidence.first, *evidence.second}}
    for pair in range(evidence.pairs):
        own = slice(bounds[pair], bounds[pair + 1])
        first_m[own] = sample_depth(depth[int(evidence.first[pair])], sampled_at(evidence.first_px[own]))
        second_m[own] = sample_depth(depth[int(evidence.second[pair])], sampled_at(evidence.second_px[own]))
    return replace(evidence, first_m=first_m, second_m=second_m)


def _nearest_by_pose(source: FrameSource, row: int) -> int | None:
    """Return the frame that the poses put nearest to another, none of its neighbours in time."""
    own = source.frames[row].scan_from_camera
    best, best_distance = None, 1.0
    for other, frame in enumerate(source.frames):
        if abs(other - row) < 2:
            continue
        distance = max(
            position_difference_m(own, frame.scan_from_camera) / OPTIONS.near_m,
            attitude_difference_rad(own, frame.scan_from_camera) / OPTIONS.near_rad,
        )
        if distance < best_distance:
            best, best_distance = other, distance
    return best


def _own_error_px(a_px: Array, b_px: Array, camera: Camera) -> float:
    """Return the median error of matches under the relative pose that fits them best, at the focal length of
    reference; NaN where none is found."""
    limit_px = OPTIONS.verification_px * camera.focal_px / REFERENCE_FOCAL_PX
    found = estimate_relative_pose(a_px, b_px, camera, camera, max_error_px=limit_px)
    if found is None:
        return float("nan")
    errors = sampson_errors(
        essential_from_pose(found.b_from_a), camera.normalize(a_px), camera.normalize(b_px)
    )
    return float(np.median(errors)) * REFERENCE_FOCAL_PX


def _packed(pairs: Sequence[_Pair], source: FrameSource, tried: int) -> Evidence:
    counts = [len(pair.first_px) for pair in pairs]
    noise = np.array([pair.noise_px for pair in pairs])
    usual = float(np.nanmedian(noise)) if np.isfinite(noise).any() else LIMITS.min_noise_px
    none = np.zeros((0, 2)), np.zeros(0), np.zeros((0, len(ASIDE) + len(FIELDS)))
    return Evidence(
        first=np.array([pair.first for pair in pairs], dtype=np.intp),
        second=np.array([pair.second for pair in pairs], dtype=np.intp),
        pair=np.repeat(np.arange(len(pairs)), counts),
        first_px=np.concatenate([none[0], *(pair.first_px for pair in pairs)]),
        second_px=np.concatenate([none[0], *(pair.second_px for pair in pairs)]),
        first_m=np.concatenate([none[1], *(pair.first_m for pair in pairs)]),
        second_m=np.concatenate([none[1], *(pair.second_m for pair in pairs)]),
        first_aside_m=np.concatenate([none[2], *(pair.first_aside_m for pair in pairs)]),
        second_aside_m=np.concatenate([none[2], *(pair.second_aside_m for pair in pairs)]),
        noise_px=np.where(np.isfinite(noise), noise, usual),
        motion_px=_motion_px(pairs, source),
        tried=tried,
    )


def _motion_px(pairs: Sequence[_Pair], source: FrameSource) -> Array:
    """Return how far matches (p,) move during `LIMITS.shutter_s`, by the fastest pair of each pair's frames."""
    speeds = []
    for pair in pairs:
        elapsed_s = abs(source.frames[pair.first].timestamp_s - source.frames[pair.second].timestamp_s)
        # Without times that differ nothing is known of the speed.
        speeds.append(pair.shift_px / elapsed_s if elapsed_s > 1e-6 else 0.0)
    fastest: dict[int, float] = {}
    for pair, speed in zip(pairs, speeds, strict=True):
        for row in (pair.first, pair.second):
            fastest[row] = max(fastest.get(row, 0.0), speed)
    return LIMITS.shutter_s * np.array([max(fastest[pair.first], fastest[pair.second]) for pair in pairs])
