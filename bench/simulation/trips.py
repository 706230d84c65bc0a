"""The trips of a simulation: where from, where to, and which landmarks must be passed on the way (C 6.1.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from app.engine.floors.floor import Floor
from app.engine.navigation.model import Route
from app.engine.navigation.places import PlanPlace
from app.errors import InvalidInputError
from app.geometry.plan import plan_position
from app.geometry.se3 import Pose

# Largest relative difference of a route's length from the wanted one.
LENGTH_SHARE = 0.15
# A landmark within this distance counts as passed.
PASSED_M = 2.0
# The destination within this distance counts as reached.
REACHED_M = 3.0
# A route counts from this distance on: before it the walker has not set out.
START_M = 1.0


@dataclass(frozen=True, slots=True)
class Spot:
    """A place of a route that must be come by: its name and plan point."""

    name: str
    place: PlanPlace


@dataclass(frozen=True, slots=True, kw_only=True)
class Trip:
    """A trip: number, demanded length, start in world metres, destination's id, the route's length and spots."""

    number: int
    length_m: float
    start: tuple[float, float, int]
    heading_deg: float
    destination: str
    route_m: float
    spots: tuple[Spot, ...]
    end: PlanPlace


def spots_of(route: Route) -> tuple[Spot, ...]:
    """Return what must be passed on a route in order: its turns, its changes of floor, its landmarks."""
    found = [
        (step.along_m, step.turn, PlanPlace(step.floor, step.x, step.y)) for step in route.steps[:-1]
    ] + [
        (
            passage.along_m,
            passage.landmark.id,
            PlanPlace(passage.floor, passage.landmark.x, passage.landmark.y),
        )
        for passage in route.passages
    ]
    return tuple(Spot(name, place) for along_m, name, place in sorted(found, key=_along) if along_m > START_M)


def _along(row: tuple[float, str, PlanPlace]) -> float:
    return row[0]


def length_range(length_m: float) -> tuple[float, float]:
    """Return the least and the greatest length of a route that counts as so long."""
    return (1 - LENGTH_SHARE) * length_m, (1 + LENGTH_SHARE) * length_m


def pairs_by_length(
    routes: Mapping[tuple[str, str], Route], lengths: Sequence[float]
) -> dict[float, list[tuple[str, str]]]:
    """Return the (start, end) pairs whose routes are as long as demanded; raises `InvalidInputError` for none.

    Routes by lift are left out: a walker of the simulation can't ride one.
    """
    found: dict[float, list[tuple[str, str]]] = {}
    for length_m in lengths:
        least_m, most_m = length_range(length_m)
        found[length_m] = [
            pair
            for pair, route in sorted(routes.items())
            if least_m <= route.distance_m <= most_m and not {*route.modes} & {"lift", "escalator"}
        ]
        if not found[length_m]:
            raise InvalidInputError(
                f"No route of the venue is {length_m:g} m long; the longest is "
                f"{max((route.distance_m for route in routes.values()), default=0.0):.0f} m. Ask for others."
            )
    return found


def shuffled(
    pairs: Mapping[float, Sequence[tuple[str, str]]], runs: int, seed: int
) -> list[tuple[float, tuple[str, str]]]:
    """Return a length and a pair for each run: lengths in turn, pairs by chance, none twice before all were."""
    rng = np.random.default_rng([seed, 1])
    orders = {length_m: rng.permutation(len(found)) for length_m, found in pairs.items()}
    lengths = list(pairs)
    chosen = []
    for run in range(runs):
        length_m = lengths[run % len(lengths)]
        order = orders[length_m]
        chosen.append((length_m, pairs[length_m][int(order[run // len(lengths) % len(order)])]))
    return chosen


def candidates(starts: Sequence[str], ends: Sequence[str]) -> list[tuple[str, str]]:
    """Return all pairs of different places."""
    return [(a, b) for a, b in product(starts, ends) if a != b]


class Progress:
    """How far a walker has come by the spots of a trip, judged by the true place."""

    def __init__(self, trip: Trip, floors: Mapping[int, Floor]) -> None:
        self._trip = trip
        self._floors = floors
        self.passed = 0

    def place(self, x: float, y: float, floor: int) -> PlanPlace:
        """Return a place of the world on its floor's plan."""
        return place_on(self._floors[floor], x, y)

    def come_to(self, x: float, y: float, floor: int) -> None:
        """Note a place that the walker came to."""
        here, spots = self.place(x, y, floor), self._trip.spots
        while self.passed < len(spots) and apart_m(here, spots[self.passed].place) <= PASSED_M:
            self.passed += 1

    def is_there(self, x: float, y: float, floor: int) -> bool:
        """Return whether a place is at the destination."""
        return apart_m(self.place(x, y, floor), self._trip.end) <= REACHED_M


def place_on(floor: Floor, x: float, y: float) -> PlanPlace:
    """Return a point of the world on a floor's plan."""
    point = plan_position(np.asarray(floor.plan_from_world), Pose(np.eye(3), np.array([x, y, 0.0])))
    return PlanPlace(floor.id, point.x, point.y)


def apart_m(a: PlanPlace, b: PlanPlace) -> float:
    """Return the distance of two places; infinite on different floors."""
    return float(np.hypot(a.x - b.x, a.y - b.y)) if a.floor == b.floor else float("inf")
