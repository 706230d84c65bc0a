"""Poses that are late or early: the time offset under which the matches fit them best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from app.engine.mapping.examination.agreement import Rays, misfit
from app.engine.mapping.examination.evidence import Evidence
from app.geometry.camera import Camera
from app.geometry.se3 import quaternion_from_rotation
from app.importers.association import Trajectory
from app.importers.conventions import PoseArrays, PoseConvention
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeOffsetOptions:
    """How a time offset is searched for."""

    max_offset_s: float = limit(
        1.0,
        "Offsets are searched up to this, or to four frames if that is more.",
        chosen="By hand: delays of video and of tracking are below half a second.",
    )
    grid_steps: int = limit(
        40, "Offsets that are tried on each side of zero.", chosen="By hand: a step of 25 ms in a second."
    )
    searched_matches: int = limit(
        40,
        "Matches of a pair that a search looks at.",
        chosen="By hand: the search then takes half a second.",
    )
    apart_s: float = limit(
        0.08,
        "Time offsets by the first and the last half of a scan that differ by more than this are of two clocks that "
        "don't run alike.",
        chosen="By hand: twice the error of an offset by half of the pairs.",
    )
    min_pair_share: float = limit(
        0.6, "Pairs whose moved times still lie within the scan, for an offset to count.", chosen="By hand."
    )


OPTIONS = TimeOffsetOptions()


@dataclass(frozen=True, slots=True)
class Track:
    """Poses over time as they are written: times (k,) in seconds, ascending, quaternions (k, 4), positions (k, 3).

    `convention` says how they are read.
    """

    times_s: Array
    quaternions: Array
    positions: Array
    convention: PoseConvention

    @staticmethod
    def of_frames(times_s: Array, poses: PoseArrays, convention: PoseConvention) -> Track:
        """Return the track of frames; those of one time after each other are taken as they come."""
        written = convention.written(poses)
        quaternions = np.stack([quaternion_from_rotation(rotation) for rotation in written.rotations])
        return Track(times_s, _continuous(quaternions), written.positions, convention)

    @staticmethod
    def of_rows(trajectory: Trajectory, convention: PoseConvention) -> Track:
        """Return the track of a trajectory's rows, which often lie closer than the frames."""
        known = trajectory.valid
        quaternions = _continuous(trajectory.quaternions[known])
        return Track(trajectory.times_s[known], quaternions, trajectory.positions_m[known], convention)

    def at(self, times_s: Array) -> tuple[PoseArrays, Mask]:
        """Return the poses `scan_from_camera` at times (n,), and which (n,) of these lie within the track."""
        right = np.clip(np.searchsorted(self.times_s, times_s, side="left"), 1, len(self.times_s) - 1)
        left = right - 1
        elapsed = np.maximum(self.times_s[right] - self.times_s[left], 1e-9)
        share = np.clip((times_s - self.times_s[left]) / elapsed, 0.0, 1.0)[:, None]
        # Between neighbouring rows the chord of two quaternions is as good as their arc.
        quaternions = (1 - share) * self.quaternions[left] + share * self.quaternions[right]
        positions = (1 - share) * self.positions[left] + share * self.positions[right]
        inside = (times_s >= self.times_s[0] - 1e-6) & (times_s <= self.times_s[-1] + 1e-6)
        return self.convention.read(PoseArrays(_rotations(quaternions), positions)), inside


def fit_time_offset(evidence: Evidence, camera: Camera, track: Track, times_s: Array) -> float | None:
    """Return the offset in seconds, to be added to a frame's time (n,) to find its pose, that fits the matches best.

    None when the frames have no times that differ.
    """
    spacing_s = float(np.median(np.diff(times_s)))
    if spacing_s <= 1e-6 or len(track.times_s) < 2:
        return None
    few, used_s = _of_used_frames(evidence.thinned(OPTIONS.searched_matches), times_s)
    rays = Rays.of(few, camera)

    def cost(offset_s: float) -> float:
        poses, inside = track.at(used_s + offset_s)
        within = inside[few.first] & inside[few.second]
        if np.count_nonzero(within) < OPTIONS.min_pair_share * few.pairs:
            return 1.0
        matches = within[few.pair]
        return misfit(few.of_pairs(within), Rays(rays.first[matches], rays.second[matches]), poses)

    longest = max(OPTIONS.max_offset_s, 4 * spacing_s)
    # Where frames are far apart, the poses between them are only guessed: whole frames are tried as well.
    whole = spacing_s * np.arange(-4, 5)
    grid = np.unique(np.concatenate([np.linspace(-longest, longest, 2 * OPTIONS.grid_steps + 1), whole]))
    costs = np.array([cost(float(value)) for value in grid])
    best = int(np.argmin(costs))
    step = float(max(np.diff(grid)))
    found = minimize_scalar(
        cost, bounds=(grid[best] - step, grid[best] + step), method="bounded", options={"maxiter": 25}
    )
    return float(found.x) if found.fun < costs[best] else float(grid[best])


def offset_changes(evidence: Evidence, camera: Camera, track: Track, times_s: Array) -> bool:
    """Return whether the first half of the scan shows another offset than the last, as clocks that don't run alike."""
    early = evidence.first < np.median(evidence.first)
    first_s, last_s = (
        fit_time_offset(evidence.of_pairs(half), camera, track, times_s) for half in (early, ~early)
    )
    return first_s is not None and last_s is not None and abs(first_s - last_s) > OPTIONS.apart_s


def _of_used_frames(evidence: Evidence, times_s: Array) -> tuple[Evidence, Array]:
    """Return the evidence with its frames numbered anew, without those in no pair, and their times."""
    used = np.unique(np.concatenate([evidence.first, evidence.second]))
    first, second = np.searchsorted(used, evidence.first), np.searchsorted(used, evidence.second)
    return replace(evidence, first=first, second=second), times_s[used]


def _continuous(quaternions: Array) -> Array:
    """Return quaternions (k, 4) of the same rotations, each in the half space of the one before it."""
    signs = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
    flips = np.concatenate([[1.0], np.cumprod(np.where(signs == 0, 1.0, signs))])
    return np.asarray(quaternions * flips[:, None])


def _rotations(quaternions: Array) -> Array:
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )
