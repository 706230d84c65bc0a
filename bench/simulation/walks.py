"""Simulated navigation: a walker in a building sees by a phone and does what guidance says (C 6.1.3, 6.2.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from app.engine.floors.floor import Floor
from app.engine.navigation.places import PlanPlace
from app.geometry.se3 import Pose
from bench.simulation.trips import Progress, Trip, apart_m
from bench.simulation.walker import Building, Walker

# A walker gives up after this time, and the next one for each metre of the route.
PATIENCE_S = 60.0
PATIENCE_S_PER_M = 3.0
# A place with a larger error, or on another floor, is wrong.
WRONG_M = 0.5
# A place that is off by more than this, and by more than this many stated sigmas, was wrong and not said to be.
BEYOND_M = 1.0
BEYOND_SIGMAS = 3.0
# A walker without guidance for this time, enough to look around and go back three times, is lost.
SILENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Shot:
    """How a picture is taken: where and when, how fast the camera turns, degrees a second, and how much light there
    is, as a share of the day's."""

    world_from_camera: Pose
    floor: int
    time_s: float
    turned_deg_s: float
    light: float


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back for a picture: guidance, the place on a plan if there is one, how long it took, and the position's
    sigma as stated."""

    guidance: Mapping[str, Any] | None
    place: PlanPlace | None
    milliseconds: float = 0.0
    sigma_m: float | None = None

    @property
    def leads(self) -> bool:
        """Whether this says where to go, and not only that it is not known."""
        return self.guidance is not None and self.guidance.get("problem") is None


class Navigator(Protocol):
    """What a walker's phone asks."""

    def begin(self, destination: str, /) -> None:
        """Begin a new session that leads to a landmark."""

    def ask(self, shot: Shot, rng: np.random.Generator, /) -> Answer:
        """Take a picture, send it, and return what comes back."""

    def end(self) -> None:
        """End the session."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a trip. `end` is `arrived`, `arrived elsewhere`, `missed a landmark`, `lost` or
    `gave up`; errors are those of the place on the plan, metres, of the frames with one on the right floor.
    `wrong_frames` got a place with an error above 0.5 m, or on another floor; `beyond_frames` one with an error above
    1 m and three stated sigmas, or on another floor."""

    trip: int
    length_m: float
    route_m: float
    destination: str
    end: str
    spots: int
    passed: int
    walked_m: float
    seconds: float
    frames: int
    told_percent: float
    off_route_frames: int
    wrong_floor_frames: int
    wrong_frames: int
    mean_error_m: float | None
    p90_error_m: float | None
    largest_error_m: float | None
    off_destination_m: float
    mean_ms: float
    beyond_frames: int = 0

    @property
    def is_success(self) -> bool:
        """Whether every spot was passed in order and guidance said `arrived` at the destination."""
        return self.end == "arrived"


@dataclass(slots=True, kw_only=True)
class _Log:
    """What is noted on the way."""

    errors_m: list[float] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)
    frames: int = 0
    located: int = 0
    off_route: int = 0
    wrong_floor: int = 0
    beyond: int = 0
    was_guided: bool = False

    def note(self, answer: Answer, truth: PlanPlace) -> None:
        """Note an answer."""
        self.frames += 1
        self.milliseconds.append(answer.milliseconds)
        self.was_guided = answer.leads
        if answer.place is None:
            return
        self.located += 1
        self.off_route += bool(answer.guidance and answer.guidance.get("off_route"))
        if answer.place.floor == truth.floor:
            error_m = apart_m(answer.place, truth)
            self.errors_m.append(error_m)
            self.beyond += error_m > max(BEYOND_M, BEYOND_SIGMAS * (answer.sigma_m or 0.0))
        else:
            self.wrong_floor += 1


def walk_trip(
    trip: Trip,
    building: Building,
    floors: Mapping[int, Floor],
    navigator: Navigator,
    *,
    fps: float,
    light: float = 1.0,
    seed: int = 0,
    silence_s: float = SILENCE_S,
) -> Outcome:
    """Walk a trip by guidance alone and return what came of it. `floors` are those of the building by number; after
    `silence_s` without guidance the walker is lost."""
    x, y, floor = trip.start
    rng = np.random.default_rng([seed, 2, trip.number])
    walker = Walker(building=building, x=x, y=y, floor=floor, heading_deg=trip.heading_deg, rng=rng)
    pictures = np.random.default_rng([seed, 3, trip.number])
    progress, log, arrived = Progress(trip, floors), _Log(), False
    navigator.begin(trip.destination)
    try:
        guided_s = 0.0
        until_s = PATIENCE_S + PATIENCE_S_PER_M * trip.route_m
        while not arrived and walker.time_s < min(until_s, guided_s + silence_s):
            pose = walker.camera_pose()
            shot = Shot(pose, walker.floor, walker.time_s, walker.turned_deg_s, light)
            answer = navigator.ask(shot, pictures)
            log.note(answer, progress.place(walker.x, walker.y, walker.floor))
            guided_s = walker.time_s if answer.leads else guided_s
            arrived = answer.guidance is not None and bool(answer.guidance["arrived"])
            for place in [] if arrived else walker.follow(answer.guidance, 1.0 / fps):
                progress.come_to(*place)
    finally:
        navigator.end()
    return _outcome(trip, walker, progress, log, arrived)


def _outcome(trip: Trip, walker: Walker, progress: Progress, log: _Log, arrived: bool) -> Outcome:
    here = (walker.x, walker.y, walker.floor)
    end = "gave up" if log.was_guided else "lost"
    if arrived and not progress.is_there(*here):
        end = "arrived elsewhere"
    elif arrived:
        end = "arrived" if progress.passed == len(trip.spots) else "missed a landmark"
    off_m = apart_m(progress.place(*here), trip.end)
    return Outcome(
        trip=trip.number,
        length_m=trip.length_m,
        route_m=round(trip.route_m, 1),
        destination=trip.destination,
        end=end,
        spots=len(trip.spots),
        passed=progress.passed,
        walked_m=round(walker.walked_m, 1),
        seconds=round(walker.time_s, 1),
        frames=log.frames,
        told_percent=round(100.0 * log.located / max(log.frames, 1), 1),
        off_route_frames=log.off_route,
        wrong_floor_frames=log.wrong_floor,
        wrong_frames=log.wrong_floor + sum(error > WRONG_M for error in log.errors_m),
        mean_error_m=_rounded(log.errors_m, np.mean),
        p90_error_m=_rounded(log.errors_m, lambda values: np.percentile(values, 90)),
        largest_error_m=_rounded(log.errors_m, np.max),
        off_destination_m=round(min(off_m, 999.0), 2),
        mean_ms=round(float(np.mean(log.milliseconds)), 1) if log.milliseconds else 0.0,
        beyond_frames=log.wrong_floor + log.beyond,
    )


def _rounded(values: list[float], of: Any) -> float | None:
    return round(float(of(values)), 3) if values else None
