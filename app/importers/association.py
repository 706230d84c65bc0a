"""Bringing together by time what was recorded apart: colour with depth, colour with the trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]

# A double holds seconds since 1970 to 0.24 microseconds, so a difference of just the tolerance may exceed it.
TIME_ROUNDING_S = 1e-6
# Below this angle the sine ratio of SLERP loses digits, and the chord is the arc to 1e-12.
SMALL_ANGLE_RAD = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociationOptions:
    """How much work lists may make."""

    max_pairs: int = limit(
        5_000_000,
        "Pairs of entries within the tolerance of time; more are refused.",
        chosen="By hand: 100,000 images against rows at 1000 Hz are 4 million.",
    )


OPTIONS = AssociationOptions()


def associate(times_s: Array, other_times_s: Array, max_difference_s: float) -> NDArray[np.int64]:
    """Return for each of the times (n,) the index of its partner among the others (m,), or -1, as (n,).

    Pairs within the tolerance are made in the order of their difference, and each entry is in one pair at
    most (A's input step; the rule of the TUM benchmark). Raises `InvalidScanError` when so many entries share
    a time that the times can't be seconds.
    """
    partner = np.full(len(times_s), -1, dtype=np.int64)
    first, second = _pairs_within(times_s, other_times_s, max_difference_s)
    difference = np.abs(times_s[first] - other_times_s[second])
    taken = np.zeros(len(other_times_s), dtype=bool)
    for k in np.lexsort((second, first, difference)):
        i, j = first[k], second[k]
        if partner[i] < 0 and not taken[j]:
            partner[i], taken[j] = j, True
    return partner


def _pairs_within(a: Array, b: Array, tolerance_s: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices into `a` and `b`, two arrays of one length, of all pairs within the tolerance."""
    order = np.argsort(b, kind="stable")
    reach = tolerance_s + TIME_ROUNDING_S
    start = np.searchsorted(b[order], a - reach, side="left")
    count = np.searchsorted(b[order], a + reach, side="right") - start
    total = int(count.sum())
    if total > OPTIONS.max_pairs:
        raise InvalidScanError("Too many entries share one time: the lists must give their times in seconds.")
    first = np.repeat(np.arange(len(a)), count)
    offset = np.arange(total) - np.repeat(np.cumsum(count) - count, count)
    return first, order[np.repeat(start, count) + offset]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses `scan_from_camera` over time.

    Times (n,) in seconds, ascending; positions (n, 3) in metres; unit quaternions (n, 4) `x y z w`; `valid`
    (n,) is False for the rows with numbers that are not finite or a zero quaternion. Between rows up to `reach_s`
    away a pose is interpolated whatever the tolerance; 0 but for a trajectory whose times were moved.
    """

    times_s: Array
    positions_m: Array
    quaternions: Array
    valid: NDArray[np.bool_]
    reach_s: float = 0.0

    @staticmethod
    def from_rows(rows: Array) -> Trajectory:
        """Return the trajectory of rows (n, 8) `t x y z qx qy qz qw` in any order.

        Of rows with equal times the first counts.
        """
        times, index = np.unique(rows[:, 0], return_index=True)
        positions, quaternions = rows[index, 1:4], rows[index, 4:8]
        norms = np.linalg.norm(quaternions, axis=1)
        valid = np.isfinite(positions).all(axis=1) & np.isfinite(norms) & (norms > 1e-6)
        with np.errstate(invalid="ignore", divide="ignore"):
            return Trajectory(times, positions, quaternions / norms[:, None], valid)

    @staticmethod
    def still(times_s: Array) -> Trajectory:
        """Return the same pose at all times (n,) in any order: it stands for poses that are estimated later."""
        ordered = np.sort(times_s)
        return Trajectory.from_rows(
            np.column_stack([ordered, np.tile([0.0, 0, 0, 0, 0, 0, 1], (len(ordered), 1))])
        )

    def moved(self, offset_s: float) -> Trajectory:
        """Return the trajectory whose pose at a time is the one that was at the time plus an offset."""
        # Rows that were at the frames' times lie between them now.
        reach_s = float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0
        return replace(self, times_s=self.times_s - offset_s, reach_s=reach_s)

    def pose_at(self, time_s: float, max_difference_s: float) -> Pose | str:
        """Return `scan_from_camera` at a time, or the reason why there is none: `no_pose` or `invalid_pose`.

        A row of exactly this time is taken as it is. Between two rows that are both within the tolerance the
        pose is interpolated, linearly and by SLERP; otherwise the nearest row within the tolerance is taken.
        If the nearest row holds no pose, none is made up from its neighbours.
        """
        right = int(np.searchsorted(self.times_s, time_s))
        inside = self.times_s[0] <= time_s <= self.times_s[-1]
        reach = (max(max_difference_s, self.reach_s) if inside else max_difference_s) + TIME_ROUNDING_S
        near = [
            i
            for i in (right - 1, right)
            if 0 <= i < len(self.times_s) and abs(self.times_s[i] - time_s) <= reach
        ]
        if not near:
            return "no_pose"
        nearest = min(near, key=lambda i: abs(self.times_s[i] - time_s))
        if not self.valid[nearest]:
            return "invalid_pose"
        if len(near) == 1 or self.times_s[nearest] == time_s or not self.valid[near].all():
            return Pose.from_quaternion(self.positions_m[nearest], self.quaternions[nearest])
        return self._between(near[0], near[1], time_s)

    def pose_between(self, time_s: float, max_gap_s: float, max_difference_s: float) -> Pose | str:
        """Return as `pose_at`, and interpolate between rows that are at most `max_gap_s` apart.

        In a larger gap, before the first and after the last row only rows within `max_difference_s` count.
        """
        right = int(np.searchsorted(self.times_s, time_s))
        is_inside = 0 < right < len(self.times_s)
        if is_inside and self.times_s[right] - self.times_s[right - 1] <= max_gap_s:
            return self.pose_at(time_s, max(max_gap_s, max_difference_s))
        return self.pose_at(time_s, max_difference_s)

    def _between(self, i: int, j: int, time_s: float) -> Pose:
        fraction = (time_s - self.times_s[i]) / (self.times_s[j] - self.times_s[i])
        position = (1 - fraction) * self.positions_m[i] + fraction * self.positions_m[j]
        return Pose.from_quaternion(position, slerp(self.quaternions[i], self.quaternions[j], fraction))


def slerp(a: Array, b: Array, fraction: float) -> Array:
    """Return the unit quaternion (4,) at `fraction` (0 to 1) of the shorter arc between two of them (SLERP)."""
    cos = float(a @ b)
    if cos < 0:
        b, cos = -b, -cos
    angle_rad = float(np.arctan2(np.linalg.norm(b - cos * a), cos))
    if angle_rad < SMALL_ANGLE_RAD:
        mixed = (1 - fraction) * a + fraction * b
    else:
        mixed = np.sin((1 - fraction) * angle_rad) * a + np.sin(fraction * angle_rad) * b
    return np.asarray(mixed / np.linalg.norm(mixed))
