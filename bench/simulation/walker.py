"""A walker who knows nothing but what guidance says, in a building whose walls and furniture stop them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from app.geometry.se3 import Pose

SPEED_M_S = 1.2
# Slow enough for sharp pictures.
TURN_DEG_S = 40.0
# While looking around without guidance.
LOOK_DEG_S = 30.0
# A walker who has to turn further than this stands while turning.
STAND_DEG = 40.0
# Turns of the arrow below this are not corrected.
UNSEEN_DEG = 8.0
# Without guidance a walker looks around for this time.
LOOK_AROUND_S = 13.0
# Then the walker goes back, or out by the door, for this time, and looks around again.
GO_BACK_S = 6.0
# Distance between the remembered points of the walker's own path.
TRAIL_M = 0.5
STEP_S = 0.1
# Turns of guidance that lead to the other end of the stairs; on stairs a walker needs no arrow.
STAIRS = {"up": True, "down": False}
# Directions in which a walker tries to pass what stands in the way.
DETOURS_DEG = (0, 20, -20, 40, -40, 60, -60, 80, -80)
EYE_HEIGHT_M = 1.5
BOB_M = 0.02
BOB_HZ = 1.8


class Building(Protocol):
    """What stops walkers, and carries them from floor to floor."""

    def is_free(self, x: float, y: float, floor: int, /) -> bool:
        """Return whether a person can stand at a point of the world, metres."""

    def floor_at(self, x: float, y: float, floor: int, /) -> int:
        """Return the floor that a walker is on who came from `floor`; it changes on stairs."""

    def ground_m(self, x: float, y: float, floor: int, /) -> float:
        """Return the world z underfoot."""

    def stairs_end(self, x: float, y: float, up: bool, /) -> tuple[float, float] | None:
        """Return where a person in a stairwell goes who takes the stairs up or down: to the other end, then out by
        its door; None outside."""

    def way_out(self, x: float, y: float, floor: int, /) -> list[tuple[float, float]]:
        """Return the way of a person who leaves a room by the nearest door: points, none without a door."""


@dataclass(frozen=True, slots=True)
class Gait:
    """How inexact a walker is: step length from person to person and from step to step, as shares; turns, as a
    share; how far the direction drifts in a second."""

    person: float = 0.07
    step: float = 0.08
    turn: float = 0.1
    drift_deg_s: float = 3.0


@dataclass(slots=True, kw_only=True)
class Walker:
    """A person in a building, at world (x, y) of a floor, facing `heading_deg` counter-clockwise from world x.

    `follow` takes what guidance said and moves for a while; the true place is never asked for what to do.
    """

    building: Building
    x: float
    y: float
    floor: int
    heading_deg: float
    rng: np.random.Generator
    gait: Gait = Gait()
    time_s: float = 0.0
    walked_m: float = 0.0
    turned_deg_s: float = 0.0
    _stairs: bool | None = None
    _climbs: bool = False
    _trail: list[tuple[float, float]] = field(default_factory=list)
    _stride: float = 1.0
    _unguided_s: float = 0.0
    _owed_deg: float = 0.0
    _gone_on_m: float = 0.0

    def __post_init__(self) -> None:
        self._stride = 1.0 + self.gait.person * float(np.clip(self.rng.standard_normal(), -2, 2))

    def follow(self, guidance: Mapping[str, Any] | None, seconds: float) -> list[tuple[float, float, int]]:
        """Walk for a while by guidance and return the places (x, y, floor) that were passed."""
        stairs = self._on_stairs(guidance)
        goes_on_m = 0.0 if guidance is None else (guidance.get("go_on_m") or 0.0) - self._gone_on_m
        if stairs is not None:
            self._unguided_s, turn_deg, reach_m = 0.0, *stairs
        elif guidance is not None and goes_on_m > 0.0:
            self._unguided_s, turn_deg, reach_m = 0.0, self._owed_deg, goes_on_m
        elif guidance is None or guidance.get("problem") is not None:
            self._unguided_s += seconds
            turn_deg, reach_m = self._without_guidance(seconds)
        else:
            self._unguided_s = self._gone_on_m = 0.0
            turn_deg, reach_m = self._by_guidance(guidance)
            here = (self.x, self.y)
            if (
                not self._trail
                or np.hypot(here[0] - self._trail[-1][0], here[1] - self._trail[-1][1]) >= TRAIL_M
            ):
                self._trail.append(here)
        passed, before_deg, before_m = [], self.heading_deg, self.walked_m
        for _ in range(max(round(seconds / STEP_S), 1)):
            step_s = seconds / max(round(seconds / STEP_S), 1)
            turn_deg -= self._turn(turn_deg, step_s)
            if abs(turn_deg) <= STAND_DEG:
                reach_m -= self._walk(min(SPEED_M_S * step_s, max(reach_m, 0.0)))
            self.time_s += step_s
            passed.append((self.x, self.y, self.floor))
        # A turn that guidance asked for is finished, located or not.
        self._owed_deg, self._gone_on_m = turn_deg, self._gone_on_m + self.walked_m - before_m
        self.turned_deg_s = ((self.heading_deg - before_deg + 180.0) % 360.0 - 180.0) / seconds
        return passed

    def _on_stairs(self, guidance: Mapping[str, Any] | None) -> tuple[float, float] | None:
        """Return how far to turn and to walk on stairs that guidance said to take, None when there are none here."""
        if guidance is not None and "turn" in guidance and not self._climbs:
            self._stairs = STAIRS.get(guidance["turn"])
        end = None if self._stairs is None else self.building.stairs_end(self.x, self.y, bool(self._stairs))
        if end is None:
            self._stairs, self._climbs = (None if self._climbs else self._stairs), False
            return None
        self._climbs = True
        return self._towards(*end)

    def _by_guidance(self, guidance: Mapping[str, Any]) -> tuple[float, float]:
        """Return how far to turn and to walk by guidance, as this person does it."""
        if guidance["off_route"] or guidance["arrived"]:
            return 0.0, 0.0
        bearing_deg = guidance["bearing_deg"] or 0.0
        if abs(bearing_deg) < UNSEEN_DEG:
            bearing_deg = 0.0
        exact = 1.0 + self.gait.turn * float(self.rng.standard_normal())
        turn_deg = bearing_deg * exact
        remaining_m = guidance["remaining_m"]
        return turn_deg, np.inf if remaining_m is None else remaining_m

    def _without_guidance(self, seconds: float) -> tuple[float, float]:
        """Return how far to turn and to walk without guidance: around, then back, and so on."""
        phase_s = self._unguided_s % (LOOK_AROUND_S + GO_BACK_S)
        if phase_s <= LOOK_AROUND_S:
            return LOOK_DEG_S * seconds, 0.0
        return self._back(begins=phase_s - LOOK_AROUND_S <= seconds)

    def _back(self, begins: bool) -> tuple[float, float]:
        """Return how far to turn and to walk to where the walker was before; out by the door if they were nowhere."""
        while self._trail and np.hypot(self._trail[-1][0] - self.x, self._trail[-1][1] - self.y) < TRAIL_M:
            self._trail.pop()
        if begins and not self._trail:
            self._trail = self.building.way_out(self.x, self.y, self.floor)[::-1]
        return self._towards(*self._trail[-1]) if self._trail else (0.0, 0.0)

    def _towards(self, x: float, y: float) -> tuple[float, float]:
        angle_deg = float(np.degrees(np.arctan2(y - self.y, x - self.x)))
        return (angle_deg - self.heading_deg + 180.0) % 360.0 - 180.0, float(np.hypot(x - self.x, y - self.y))

    def _turn(self, wanted_deg: float, seconds: float) -> float:
        turned = float(np.clip(wanted_deg, -TURN_DEG_S * seconds, TURN_DEG_S * seconds))
        drift = self.gait.drift_deg_s * float(np.sqrt(seconds) * self.rng.standard_normal())
        self.heading_deg = (self.heading_deg + turned + drift + 180.0) % 360.0 - 180.0
        return turned

    def _walk(self, wanted_m: float) -> float:
        """Step ahead, around what stands there; stay when there is no way around. Return how far it went."""
        length_m = wanted_m * self._stride * (1.0 + self.gait.step * float(self.rng.standard_normal()))
        if length_m <= 0.0:
            return 0.0
        for detour_deg in DETOURS_DEG:
            angle = np.radians(self.heading_deg + detour_deg)
            x, y = self.x + length_m * float(np.cos(angle)), self.y + length_m * float(np.sin(angle))
            if self.building.is_free(x, y, self.floor):
                self.x, self.y, self.floor = x, y, self.building.floor_at(x, y, self.floor)
                self.walked_m += length_m
                return length_m
        return 0.0

    def camera_pose(self) -> Pose:
        """Return world_from_camera of the phone in the walker's hand, which sways and bobs with the steps."""
        swing = 2 * np.pi * BOB_HZ * self.time_s
        wobble = self.rng.standard_normal(3)
        yaw = np.radians(self.heading_deg + 1.0 * np.sin(swing / 2) + 0.5 * wobble[0])
        pitch, roll = np.radians(-3.0 + 0.8 * wobble[1]), np.radians(0.8 * wobble[2])
        height = self.building.ground_m(self.x, self.y, self.floor) + EYE_HEIGHT_M + BOB_M * np.sin(swing)
        forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        down = np.cross(forward, right)
        axes = (np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right)
        return Pose(np.column_stack([*axes, forward]), np.array([self.x, self.y, height]))
