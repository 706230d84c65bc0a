"""Where a camera may be on floor plans: a particle filter over place, direction and odometry's scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.walls import OPTIONS as WALLS
from app.engine.floors.walls import FloorWalls
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleOptions:
    """How many particles there are, and how they are weighted."""

    count: int = limit(1500, "Particles.", chosen="By hand: 1 to 2 ms a frame.")
    wall_weight: float = limit(
        0.02,
        "Weight of a particle that went through a wall: more than 0, as areas may be drawn where no wall is.",
        chosen="By hand.",
    )
    least_effective_share: float = limit(
        0.5, "Share of effective particles below which they are drawn anew.", chosen="By hand: the usual one."
    )
    scale_sigma: float = limit(
        0.07,
        "Relative sigma of the scale that the floor plan gives odometry.",
        chosen="Recorded walks of roomfix simulate --no-map: steps were 0.98 to 1.12 times as long as true ones.",
    )
    scale_m: float = limit(
        5.0,
        "Path over which that scale changes: furniture, doors, other rooms.",
        chosen="By hand: the length of a room.",
    )
    fix_floor_m: float = limit(
        0.15,
        "Least sigma of a fix when particles are weighted by it, so that more than a few of them count.",
        chosen="By hand: the distance between particles.",
    )
    fix_floor_rad: float = limit(
        0.05, "The same for the direction.", chosen="By hand: the distance between particles."
    )


OPTIONS = ParticleOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanMotion:
    """How a camera moved between two frames: ahead and to the left of where it looked (2,), metres, and its turn to the
    left, radians, each with one sigma besides that of the scale."""

    moved: Array
    moved_sigma_m: float
    turned_rad: float
    turned_sigma_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanBelief:
    """Place (2,), direction in radians counter-clockwise from x, and floor of a camera, with one sigma of the place as
    the root mean square error, and of the direction; `floor_share` is the probability of the floor."""

    floor: str
    floor_share: float
    xy: Array
    yaw_rad: float
    position_sigma_m: float
    yaw_sigma_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFix:
    """What an anchor says: floor, place (2,), direction, and one sigma of each."""

    floor: str
    xy: Array
    yaw_rad: float
    position_sigma_m: float
    yaw_sigma_rad: float


class Particles:
    """Hypotheses of a camera's place: (n, 2) metres of the frame of the poses, floors, directions, and the logarithm of
    what odometry's lengths are multiplied by."""

    def __init__(self, walls: Mapping[str, FloorWalls | None], fix: PlanFix) -> None:
        self._walls = dict(walls)
        self._names = list(walls)
        self._random = np.random.default_rng(0)
        n = OPTIONS.count
        self.log_scale = self._random.normal(0.0, OPTIONS.scale_sigma, n)
        self.xy, self.yaw, self.floor = self._drawn(fix)
        self._weights = np.full(n, 1.0 / n)

    def _drawn(self, fix: PlanFix) -> tuple[Array, Array, NDArray[np.int64]]:
        n = OPTIONS.count
        sigma = fix.position_sigma_m / np.sqrt(2.0)
        xy = fix.xy + self._random.normal(0.0, sigma, (n, 2))
        yaw = fix.yaw_rad + self._random.normal(0.0, fix.yaw_sigma_rad, n)
        return xy, yaw, np.full(n, self._names.index(fix.floor))

    def move(self, motion: PlanMotion) -> None:
        """Move all particles as odometry says, with its errors; who would go through a wall loses weight."""
        n = OPTIONS.count
        self._drift(float(np.linalg.norm(motion.moved)))
        along = motion.moved * np.exp(self.log_scale)[:, None]
        along = along + self._random.normal(0.0, motion.moved_sigma_m / np.sqrt(2.0), (n, 2))
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        step = np.column_stack([cos * along[:, 0] - sin * along[:, 1], sin * along[:, 0] + cos * along[:, 1]])
        start, self.xy = self.xy, self.xy + step
        self.yaw = self.yaw + motion.turned_rad + self._random.normal(0.0, motion.turned_sigma_rad, n)
        for row, name in enumerate(self._names):
            here, walls = np.flatnonzero(self.floor == row), self._walls[name]
            if walls is None or not len(here):
                continue
            crossed = walls.crossed(start[here], self.xy[here])
            self._weights[here[crossed]] *= OPTIONS.wall_weight
            self._climb(walls, here)
        self._settle()

    def _climb(self, walls: FloorWalls, here: NDArray[np.intp]) -> None:
        """Put particles that passed the middle of stairs on the floor that these lead to."""
        for stairs in walls.stairs:
            if stairs.to_floor not in self._names:
                continue
            share, away = stairs.progress(self.xy[here])
            on = (share > 0.5) & (away < WALLS.stairs_m) & (walls.labels(self.xy[here]) == stairs.area)
            self.floor[here[on]] = self._names.index(stairs.to_floor)

    def _drift(self, path_m: float) -> None:
        """Let the scale change with the path, to no more than what is not known of it at the start."""
        kept = float(np.exp(-path_m / OPTIONS.scale_m))
        fresh = OPTIONS.scale_sigma * float(np.sqrt(1.0 - kept**2))
        self.log_scale = kept * self.log_scale + self._random.normal(0.0, fresh, OPTIONS.count)

    def share_near(self, fix: PlanFix, sigmas: float) -> float:
        """Return the weight of the particles that a fix is at most a number of its sigmas away from."""
        same = self.floor == self._names.index(fix.floor)
        away = np.linalg.norm(self.xy - fix.xy, axis=1) / max(fix.position_sigma_m, OPTIONS.fix_floor_m)
        turned = np.abs(_angle(self.yaw - fix.yaw_rad)) / max(fix.yaw_sigma_rad, OPTIONS.fix_floor_rad)
        return float(self._weights[same & (away < sigmas) & (turned < sigmas)].sum())

    def correct(self, fix: PlanFix) -> None:
        """Weigh particles by a fix that agrees with them, and draw places from it where it knows them better."""
        sigma_m = max(fix.position_sigma_m, OPTIONS.fix_floor_m)
        sigma_rad = max(fix.yaw_sigma_rad, OPTIONS.fix_floor_rad)
        away = np.linalg.norm(self.xy - fix.xy, axis=1) / sigma_m
        turned = _angle(self.yaw - fix.yaw_rad) / sigma_rad
        spread = self.belief().position_sigma_m
        same = self.floor == self._names.index(fix.floor)
        # In the plane a root mean square error of 1 is a sigma of 1 / sqrt(2) along each axis.
        weights = self._weights * np.exp(-(away**2) - 0.5 * turned**2) * same
        if weights.sum() < 1e-12:
            self.restart(fix)
            return
        self._weights = weights / weights.sum()
        self._resample()
        if fix.position_sigma_m < spread:
            self.xy, self.yaw, self.floor = self._drawn(fix)

    def restart(self, fix: PlanFix) -> None:
        """Believe a fix alone."""
        self.xy, self.yaw, self.floor = self._drawn(fix)
        self._weights = np.full(OPTIONS.count, 1.0 / OPTIONS.count)

    def belief(self) -> PlanBelief:
        """Return the mean of the particles on the floor that most are on."""
        weights = self._weights
        by_floor = np.bincount(self.floor, weights, len(self._names))
        row = int(np.argmax(by_floor))
        w = weights * (self.floor == row) / by_floor[row]
        xy = w @ self.xy
        # Of someone who may be on another floor all particles count for the error.
        spread = float(np.sqrt(weights @ np.sum((self.xy - xy) ** 2, axis=1)))
        sin, cos = float(w @ np.sin(self.yaw)), float(w @ np.cos(self.yaw))
        length = min(float(np.hypot(sin, cos)), 1.0 - 1e-12)
        return PlanBelief(
            floor=self._names[row],
            floor_share=float(by_floor[row] / by_floor.sum()),
            xy=xy,
            yaw_rad=float(np.arctan2(sin, cos)),
            position_sigma_m=spread,
            yaw_sigma_rad=float(np.sqrt(-2.0 * np.log(max(length, 1e-6)))),
        )

    def _settle(self) -> None:
        total = self._weights.sum()
        self._weights = self._weights / total
        effective = 1.0 / float(np.sum(self._weights**2))
        if effective < OPTIONS.least_effective_share * OPTIONS.count:
            self._resample()

    def _resample(self) -> None:
        """Draw particles anew by their weights, systematically."""
        n = OPTIONS.count
        places = (np.arange(n) + self._random.random()) / n
        rows = np.minimum(np.searchsorted(np.cumsum(self._weights), places), n - 1)
        self.xy, self.yaw, self.floor = self.xy[rows], self.yaw[rows], self.floor[rows]
        self.log_scale = self.log_scale[rows]
        self._weights = np.full(n, 1.0 / n)


def _angle(radians: Array) -> Array:
    return np.asarray((radians + np.pi) % (2 * np.pi) - np.pi)
