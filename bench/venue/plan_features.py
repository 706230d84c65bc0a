"""The plans' GeoJSON: named areas, points of interest, landmarks, and the walkable links between landmarks.

Coordinates are plan metres. A link on one floor follows a way clear of furniture; stairs and lift link to the
landmark of the same name on the other floor, which `to_floor` names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import ArrayLike

from bench.venue.furnishing import FURNITURE
from bench.venue.layout import CORRIDORS, DOORS, FLOOR_COUNT, ROOMS, Door, Room, room_by_id
from bench.venue.openings import shared_wall
from bench.venue.plan_image import to_plan
from bench.venue.walkable import CELL_M, grid_of, way

Feature = dict[str, Any]
Point = tuple[float, float]

POI_NAMES = {
    "counter": "Counter",
    "vending": "Drinks machine",
    "vitrine": "Display case",
    "pedestal": "Sculpture",
}
STAIR_LANDMARKS = {0: (26.5, 8.3), 1: (26.5, 15.8)}
# Length of the way up the stairs, along their slope.
STAIR_LENGTH_M = 8.6
# Length that a ride in the lift counts as.
LIFT_LENGTH_M = 15.0


@dataclass(frozen=True, slots=True)
class Landmark:
    """A node of the walking graph: its id, its name, its world place."""

    id: str
    name: str
    at: Point


def features(floor: int) -> Feature:
    """Return a floor's GeoJSON FeatureCollection."""
    rooms = [room for room in ROOMS if room.floor == floor or room.id == "stair"]
    found = [_area(room, floor) for room in rooms]
    found += [poi for room in rooms for poi in _pois(room, floor)]
    marks = {room.id: _landmarks(room, floor) for room in rooms}
    unique = {mark.id: mark for group in marks.values() for mark in group}
    found += [_point("landmark", mark.id, mark.name, mark.at, floor) for mark in unique.values()]
    found += [link for room in rooms for link in _links(room, marks[room.id], floor)]
    found += list(_links_between_floors(floor))
    return {"type": "FeatureCollection", "features": found}


def _coordinates(points_xy: ArrayLike, floor: int) -> list[list[float]]:
    return [[round(float(x), 3), round(float(y), 3)] for x, y in to_plan(points_xy, floor)]


def _feature(kind: str, geometry: str, coordinates: Any, **properties: Any) -> Feature:
    return {
        "type": "Feature",
        "id": properties["id"],
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": {"kind": kind, **properties},
    }


def _area(room: Room, floor: int) -> Feature:
    x0, y0, x1, y1 = room.interior
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    area_id = room.id if room.id != "stair" else f"{floor}-stair"
    return _feature("area", "Polygon", [_coordinates(ring, floor)], id=f"area-{area_id}", name=room.name)


def _point(kind: str, point_id: str, name: str, at: Point, floor: int) -> Feature:
    return _feature(kind, "Point", _coordinates([at], floor)[0], id=point_id, name=name)


def _pois(room: Room, floor: int) -> Iterator[Feature]:
    x0, y0, _, _ = room.interior
    for k, item in enumerate(FURNITURE.get(room.id, ())):
        if item.kind in POI_NAMES:
            name = f"{POI_NAMES[item.kind]}, {room.name}"
            yield _point("poi", f"poi-{room.id}-{k}", name, (x0 + item.x, y0 + item.y), floor)


def _landmarks(room: Room, floor: int) -> list[Landmark]:
    """Return a room's own landmark and those of its open doors."""
    if room.id == "stair":
        own = Landmark(f"{floor}-stairs", "Stairs", STAIR_LANDMARKS[floor])
    else:
        x0, y0, x1, y1 = room.interior
        own = Landmark(room.id, room.name, _clear_point(((x0 + x1) / 2, (y0 + y1) / 2), room, floor))
    doors = [d for d in DOORS if d.floor == floor and room.id in (d.a, d.b) and not d.closed]
    return [own, *(_door_landmark(door) for door in doors)]


def _clear_point(middle: Point, room: Room, floor: int) -> Point:
    """Return a place near the middle of a room with room to stand."""
    clearance = grid_of(floor).clearance_m
    x0, y0, x1, y1 = (round(v / CELL_M) for v in room.interior)
    part = clearance[y0:y1, x0:x1]
    rows, columns = np.nonzero(part > min(0.6, 0.8 * part.max()))
    x, y = (columns + x0 + 0.5) * CELL_M, (rows + y0 + 0.5) * CELL_M
    best = int(np.argmin(np.hypot(x - middle[0], y - middle[1])))
    return round(float(x[best]), 2), round(float(y[best]), 2)


def _door_landmark(door: Door) -> Landmark:
    side, _, line = shared_wall(door)
    at = (door.at_m, line) if side in "NS" else (line, door.at_m)
    a, b = (room_by_id(r) for r in (door.a, door.b))
    return Landmark(f"door-{a.id}-{b.id}-{door.floor}", f"Door {a.name} / {b.name}", at)


def _links(room: Room, marks: list[Landmark], floor: int) -> Iterator[Feature]:
    """Yield links from a room's landmark to its doors; in a corridor from each to the next along it."""
    own, *doors = marks
    pairs = [(own, door) for door in doors]
    if room.id in CORRIDORS:
        pairs = list(pairwise(sorted(marks, key=lambda mark: mark.at[0])))
    for a, b in pairs:
        path = shapely.LineString([a.at, *way(a.at, b.at, floor), b.at]).simplify(0.08)
        yield _link(a.id, b.id, path.coords, float(path.length), "walk", floor, {})


def _link(
    start: str, end: str, points_xy: ArrayLike, length_m: float, mode: str, floor: int, more: dict[str, Any]
) -> Feature:
    return _feature(
        "link",
        "LineString",
        _coordinates(points_xy, floor),
        id=f"link-{start}-{end}",
        **{"from": start, "to": end, "length_m": round(length_m, 2), "mode": mode, **more},
    )


def _links_between_floors(floor: int) -> Iterator[Feature]:
    """Yield the way up or down; its line on this floor runs to where it ends, seen from above."""
    other = next(k for k in range(FLOOR_COUNT) if k != floor)
    stair = [STAIR_LANDMARKS[floor], STAIR_LANDMARKS[other]]
    yield _link(
        f"{floor}-stairs", f"{other}-stairs", stair, STAIR_LENGTH_M, "stairs", floor, {"to_floor": str(other)}
    )
    lift = _landmarks(room_by_id(f"{floor}-lift"), floor)[0].at
    yield _link(
        f"{floor}-lift",
        f"{other}-lift",
        [lift, (lift[0] + 0.01, lift[1])],
        LIFT_LENGTH_M,
        "lift",
        floor,
        {"to_floor": str(other)},
    )
