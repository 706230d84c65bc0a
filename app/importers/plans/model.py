"""An indoor map as values: what every format is read into, and what a venue is made from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

GeoJson = dict[str, Any]
Points = NDArray[np.float64]
MODE_WORDS = {"stairs": "Stairs", "lift": "Lift", "escalator": "Escalator"}


@dataclass(frozen=True, slots=True, kw_only=True)
class IndoorLevel:
    """A level: `features` is a FeatureCollection, in longitude and latitude where it has an `origin`, else in metres.

    `heights_m` are the world heights of its floor and ceiling and `plan_from_world` is a 4x4 matrix, where the
    format knows them.
    """

    id: str
    name: str
    order: int
    features: GeoJson
    heights_m: tuple[float, float] | None = None
    plan_from_world: object = None


@dataclass(frozen=True, slots=True, kw_only=True)
class IndoorMap:
    """A building and its levels, lowest first.

    `paths` counts the ways on levels and between them, `drawn` those among them that were made from the rooms'
    shapes. `left_out` counts what the map holds and a venue doesn't. `origin` is the longitude and latitude of the
    plans' (0, 0) in degrees.
    """

    id: str
    name: str
    format: str
    levels: tuple[IndoorLevel, ...]
    paths: int
    drawn: int = 0
    left_out: Mapping[str, int] = field(default_factory=dict)
    origin: tuple[float, float] | None = None


@dataclass(slots=True, kw_only=True)
class Room:
    """A polygon in plan metres. `mode` is stairs, lift or escalator for a room that leads to other levels.

    `is_open` says that it has no walls towards its neighbours that are open too; `is_area` that it becomes an area.
    """

    id: str
    name: str | None
    category: str
    polygon: shapely.Polygon
    mode: str | None = None
    is_walkable: bool = True
    is_open: bool = False
    is_area: bool = True
    properties: GeoJson = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class Door:
    """The middle of a door in plan metres."""

    x: float
    y: float
    name: str | None = None
    is_entrance: bool = False


@dataclass(slots=True, kw_only=True)
class Place:
    """A named point in plan metres; an id is made from the name where there is none, with the category where the name
    has no Latin letters."""

    x: float
    y: float
    name: str
    id: str | None = None
    kind: str = "landmark"
    category: str | None = None
    properties: GeoJson = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class Line:
    """A walkable line (n, 2) in plan metres, with the properties of its link."""

    points: Points
    id: str | None = None
    properties: GeoJson = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class Sketch:
    """One level as a format describes it. `is_complete` says that no link or landmark needs to be added."""

    order: int
    id: str
    name: str
    rooms: list[Room] = field(default_factory=list)
    doors: list[Door] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    walls: list[shapely.LineString] = field(default_factory=list)
    is_complete: bool = False
    heights_m: tuple[float, float] | None = None
    plan_from_world: object = None


@dataclass(slots=True, kw_only=True)
class Way:
    """A way from one level to another: along `points` (n, 2) in plan metres of the first level, or between two rooms.

    `rooms` are the ids of the room where it begins and of the one where it ends.
    """

    mode: str
    from_order: int
    to_order: int
    points: Points | None = None
    rooms: tuple[str, str] | None = None
    id: str | None = None
    properties: GeoJson = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class Building:
    """A whole map as a format describes it."""

    id: str
    name: str
    format: str
    sketches: list[Sketch]
    ways: list[Way] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    origin: tuple[float, float] | None = None
