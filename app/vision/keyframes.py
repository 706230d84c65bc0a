"""Choice of keyframes by pose difference (A 2.1, eq. 1-3)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.se3 import Pose
from app.limits import limit


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """The number of matches at a difference x between two camera poses: matches(x) = a x^b."""

    a: float
    b: float

    def __call__(self, difference: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(self.a * np.asarray(difference, dtype=np.float64) ** self.b)

    def inverse(self, matches: float) -> float:
        """Return the difference at which the number of matches is `matches`."""
        return float((matches / self.a) ** (1.0 / self.b))


# The curves that the RGB-D database paper fitted to scenes of TUM.
POSITION_CURVE = PowerLaw(19.43, -0.5435)
ATTITUDE_CURVE = PowerLaw(8.846, -0.8503)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeOptions:
    """How many matches neighbouring keyframes should have."""

    wanted_matches: float = limit(
        50.0,
        "Matches of two frames at the pose thresholds, unless a build states another number.",
        chosen="The RGB-D database paper's value. `roomfix evaluate SCAN` with calibrated thresholds compares 50 with "
        "100 (docs/calibration.md).",
    )


OPTIONS = KeyframeOptions()
# Steps to a cell of a grid and to those around it.
AROUND = tuple(itertools.product((-1, 0, 1), repeat=3))
# Only so that the size of a cell is not 0.
MIN_CELL_M = 1e-6
WANTED_MATCHES = OPTIONS.wanted_matches


def matches_by_position_difference(difference_m: ArrayLike) -> NDArray[np.float64]:
    """Return the matches expected at a position difference in metres (A eq. 1)."""
    return POSITION_CURVE(difference_m)


def matches_by_attitude_difference(difference_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the matches expected at an attitude difference in radians (A eq. 2)."""
    return ATTITUDE_CURVE(difference_rad)


@dataclass(frozen=True, slots=True)
class PoseThresholds:
    """A frame is close to a keyframe when the differences of position and attitude are both below these."""

    position_m: float
    attitude_rad: float


def thresholds_for_matches(
    wanted: float = WANTED_MATCHES, position: PowerLaw = POSITION_CURVE, attitude: PowerLaw = ATTITUDE_CURVE
) -> PoseThresholds:
    """Return the pose differences at which two frames have `wanted` matches: 0.1757 m, 0.1304 rad for 50 (A eq. 3)."""
    return PoseThresholds(position.inverse(wanted), attitude.inverse(wanted))


def select_by_pose(world_from_camera: Sequence[Pose], thresholds: PoseThresholds) -> list[int]:
    """Return the frames that become keyframes (A 2.1): those to which no earlier keyframe is close.

    The first frame joins. The paper compares with the last keyframe first, to save time; the result is the same.
    """
    if not world_from_camera:
        return []
    positions = np.stack([pose.translation for pose in world_from_camera])
    rotations = np.stack([pose.rotation for pose in world_from_camera])
    # The angle between two rotations is below t exactly when trace(A^T B) is above 1 + 2 cos t.
    min_trace = 1.0 + 2.0 * np.cos(min(thresholds.attitude_rad, np.pi))
    # A frame is compared with the keyframes of its cell and of those around it: the others are too far away.
    cells = np.floor(positions / max(thresholds.position_m, MIN_CELL_M)).astype(np.int64)
    chosen_in: dict[tuple[int, ...], list[int]] = {}
    chosen: list[int] = []
    for i, cell in enumerate(cells.tolist()):
        x, y, z = cell
        around = [row for dx, dy, dz in AROUND for row in chosen_in.get((x + dx, y + dy, z + dz), ())]
        near = np.linalg.norm(positions[around] - positions[i], axis=1) < thresholds.position_m
        alike = np.einsum("nij,ij->n", rotations[around], rotations[i]) > min_trace
        if not np.any(near & alike):
            chosen.append(i)
            chosen_in.setdefault((x, y, z), []).append(i)
    return chosen
