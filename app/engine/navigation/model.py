"""A route as a value, without language."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.engine.floors.model import Landmark, LinkMode
from app.engine.navigation.places import Place

Turn = Literal[
    "depart", "straight", "slight_left", "left", "sharp_left", "slight_right", "right", "sharp_right", "u_turn",
    "up", "down", "arrive",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class RoutePoint:
    """A point of a route's line: plan metres on a floor, and how far along the route it is."""

    floor: str
    x: float
    y: float
    along_m: float


@dataclass(frozen=True, slots=True)
class Passage:
    """A landmark on or beside the way, where the way is next to it."""

    floor: str
    landmark: Landmark
    along_m: float


@dataclass(frozen=True, slots=True)
class Step:
    """What to do at a point, and how far to go until the next step.

    `at` is the landmark where it is done, `towards` the one where it leads, `passing` those on the way. For `up`
    and `down`, `mode` says by what and `to_floor` where to.
    """

    turn: Turn
    floor: str
    x: float
    y: float
    along_m: float
    distance_m: float
    at: Landmark | None = None
    towards: Landmark | None = None
    passing: tuple[Landmark, ...] = ()
    mode: LinkMode = "walk"
    to_floor: str | None = None
    enters_floor: bool = False


@dataclass(frozen=True, slots=True)
class Route:
    """A way from a place to another: its line (`modes[i]` is how points[i + 1] is reached), the landmarks along it
    and the steps. `floor_names` names the floors for people."""

    start: Place
    end: Place
    points: tuple[RoutePoint, ...]
    modes: tuple[LinkMode, ...]
    passages: tuple[Passage, ...]
    steps: tuple[Step, ...]
    floor_names: dict[str, str]

    @property
    def distance_m(self) -> float:
        """The route's whole length."""
        return self.points[-1].along_m
