"""Trajectories of other programs beside ours: TUM files, aligned with the true path (as the TUM benchmark's ATE)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.alignment import align_points
from app.importers.frames import Frame
from app.importers.rows.trajectory_rows import parse_trajectory
from bench.tracking.sequences import TrackedFrame

Array = NDArray[np.float64]

# A pose belongs to the frame with the nearest time, when that is as near as this.
SAME_TIME_S = 0.02
# Poses that an alignment needs.
FEWEST = 3
HEAD = ("trajectory", "scale", "frames %", "RMSE cm", "mean cm", "median cm", "90 % cm", "largest cm")


@dataclass(frozen=True, slots=True, kw_only=True)
class PathErrors:
    """Distances from the true path after the best rotation and translation, and maybe scale; `scale` is what the
    trajectory was multiplied by, None where it was left as it is."""

    name: str
    scale: float | None
    frames_percent: float
    errors_m: Array

    def cells(self) -> tuple[str, ...]:
        """Return the figures as a table's cells."""
        centimetres = 100 * self.errors_m
        values = (
            float(np.sqrt(np.mean(centimetres**2))),
            float(np.mean(centimetres)),
            float(np.median(centimetres)),
            float(np.percentile(centimetres, 90)),
            float(np.max(centimetres)),
        )
        scale = "as it is" if self.scale is None else f"x {self.scale:.4f}"
        return (self.name, scale, f"{self.frames_percent:.1f}", *(f"{value:.2f}" for value in values))


def read_trajectory(path: Path) -> Array:
    """Return times and places (n, 4) of a trajectory file, `t x y z`; rows without a pose are left out.

    Reads what scans may have as poses: the TUM format of ORB-SLAM3 and RTAB-Map among them. Raises
    `InvalidInputError` for a file without times.
    """
    rows = parse_trajectory(path.read_text(encoding="utf-8"), path.name).values[:, :4]
    known = rows[np.isfinite(rows).all(axis=1)]
    if len(known) < FEWEST:
        raise InvalidInputError(
            f"{path.name} has {len(known)} poses with times: at least {FEWEST} are compared."
        )
    return np.asarray(known[np.argsort(known[:, 0], kind="stable")])


def compare_trajectory(name: str, trajectory: Array, frames: Sequence[Frame]) -> list[PathErrors]:
    """Return the errors of a trajectory (n, 4) against the true poses of a video's frames, its scale left and fitted.

    Returns none where they can't be aligned: all places are on one line. Raises `InvalidInputError` when fewer than
    three frames have a pose at their time.
    """
    truth = np.array([frame.scan_from_camera.translation for frame in frames])
    times = np.array([frame.timestamp_s for frame in frames], dtype=float)
    right = np.clip(np.searchsorted(trajectory[:, 0], times), 1, len(trajectory) - 1)
    left = right - 1
    nearest = np.where(
        np.abs(trajectory[left, 0] - times) <= np.abs(trajectory[right, 0] - times), left, right
    )
    rows = np.flatnonzero(np.abs(trajectory[nearest, 0] - times) <= SAME_TIME_S)
    if len(rows) < FEWEST:
        raise InvalidInputError(
            f"{name} has poses at the times of {len(rows)} of {len(frames)} frames: are its times those of the video?"
        )
    return _aligned(name, trajectory[nearest[rows], 1:], truth[rows], len(frames))


def compare_tracked(name: str, frames: Sequence[TrackedFrame]) -> list[PathErrors]:
    """Return the errors of what was tracked here: as answered, and aligned as those of other programs are."""
    rows = [frame for frame in frames if frame.position is not None]
    if len(rows) < FEWEST:
        return []
    places, truth = np.array([frame.position for frame in rows]), np.array([frame.truth for frame in rows])
    answered = PathErrors(
        name=f"{name}, not aligned",
        scale=None,
        frames_percent=100.0 * len(rows) / len(frames),
        errors_m=np.linalg.norm(places - truth, axis=1),
    )
    return [answered, *_aligned(name, places, truth, len(frames))]


def _aligned(name: str, places: Array, truth: Array, frames: int) -> list[PathErrors]:
    found = []
    for with_scale in (False, True):
        try:
            fitted = align_points(places, truth, with_scale=with_scale)
        except DegenerateGeometryError:
            # A path along one line, or a trajectory that stays at one place, can't be laid over another.
            return []
        moved = fitted.scale * places @ fitted.target_from_source.rotation.T
        errors = np.linalg.norm(moved + fitted.target_from_source.translation - truth, axis=1)
        found.append(
            PathErrors(
                name=name,
                scale=fitted.scale if with_scale else None,
                frames_percent=100.0 * len(places) / frames,
                errors_m=errors,
            )
        )
    return found
