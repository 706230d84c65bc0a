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
    """A point of a route's line: plan metres on a floor, and its distance from the start along the route."""

    floor: str
    x: float
    y: float
    along_m: float


@dataclass(frozen=True, slots=True)
class Passage:
    """A landmark that the route passes, and the distance from the start where it is nearest."""

    floor: str
    landmark: Landmark
    along_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What to do at a point of the route, and the distance to the next step.

    `at` is the landmark at the point, `towards` the one that the step leads to, `passing` are those on the way. The
    turns `up` and `down` change floors by `mode` to `to_floor`; `enters_floor` marks the first step after that.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """A way from one place to another: the points of its line, where `modes[i]` leads from point i to i + 1, the
    landmarks along it, and the steps. `floor_names` are the names of the floors by id."""

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
