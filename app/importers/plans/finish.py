"""From what a format describes to an indoor map: landmarks and links are added where it has none."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.importers.plans.model import (
    MODE_WORDS,
    Building,
    GeoJson,
    IndoorLevel,
    IndoorMap,
    Line,
    Place,
    Points,
    Room,
    Sketch,
    Way,
)
from app.importers.plans.transliteration import transliterated
from app.importers.plans.walkways import shared_rooms, stacked_rooms, walkways
from app.limits import limit

FLOOR_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishOptions:
    """What is added to a level."""

    same_point_m: float = limit(
        0.5,
        "Ends of paths and landmarks closer than this are one point.",
        chosen="By hand: formats ask for equal ones, drawing tools round; links touch what is this close.",
    )
    min_overlap_ratio: float = limit(
        0.3,
        "Stairs, lifts and escalators on consecutive levels belong together when this part of the smaller one lies "
        "above the other.",
        chosen="By hand: stairs turn between floors, and their two outlines differ.",
    )


OPTIONS = FinishOptions()


def finished(building: Building) -> IndoorMap:
    """Return the indoor map of a building; raises `InvalidInputError` for one without levels."""
    sketches = sorted(building.sketches, key=lambda sketch: sketch.order)
    if not sketches:
        raise InvalidInputError("The map has no level.")
    for sketch in sketches:
        if not sketch.is_complete:
            _add_landmarks(sketch)
    if not all(sketch.is_complete for sketch in sketches):
        building.ways += list(_stacked_ways(sketches, building.ways))
    drawn, levels = 0, []
    for sketch in sketches:
        ways = [way for way in building.ways if way.from_order == sketch.order]
        before = len(sketch.lines)
        if not sketch.is_complete:
            _add_links(sketch, _way_ends(sketch, building.ways))
        drawn += len(sketch.lines) - before
        levels.append((sketch, ways))
    landmarks = {sketch.order: _LandmarkIds(sketch) for sketch in sketches}
    floors = {sketch.order: sketch.id for sketch in sketches}
    made = tuple(
        IndoorLevel(
            id=sketch.id,
            name=sketch.name,
            order=sketch.order,
            features=_collection(sketch, ways, landmarks, floors),
            heights_m=sketch.heights_m,
            plan_from_world=sketch.plan_from_world,
        )
        for sketch, ways in levels
    )
    return IndoorMap(
        id=building.id,
        name=building.name,
        format=building.format,
        levels=made,
        paths=sum(len(sketch.lines) for sketch in sketches) + len(building.ways),
        drawn=drawn,
        left_out=dict(sorted(building.left_out.items())),
        origin=building.origin,
    )


def floor_ids(names: Sequence[Iterable[str]]) -> list[str]:
    """Return an id for each level: the first of its names that can be one, changed where another level has it."""
    taken: set[str] = set()
    return [
        free_id(next(filter(FLOOR_ID.fullmatch, map(_plain, choices)), "level"), taken) for choices in names
    ]


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", transliterated(text.strip())).lstrip("._-")[:60]


def free_id(wanted: str, taken: set[str]) -> str:
    """Return an id that is not taken, and take it."""
    free, number = wanted, 1
    while free in taken:
        number += 1
        free = f"{wanted}-{number}"
    taken.add(free)
    return free


def _add_landmarks(sketch: Sketch) -> None:
    """Add a landmark for each named room without one, for each way to other levels, and for each entrance."""
    for room in sketch.rooms:
        if room.mode is None and (room.name is None or not room.is_walkable):
            continue
        if _place_in(sketch, room, reach_m=0.0) is None:
            point = _middle(room, sketch.lines)
            name = room.name or MODE_WORDS[room.mode or "stairs"]
            sketch.places.append(Place(x=point.x, y=point.y, name=name, category=room.category))
    for door in sketch.doors:
        if door.is_entrance or (door.name and shared_rooms(sketch.rooms, door) == 1):
            name = door.name or "Entrance"
            sketch.places.append(Place(x=door.x, y=door.y, name=name, category="entrance"))


def _middle(room: Room, lines: Sequence[Line]) -> shapely.Point:
    """Return where a room's landmark stands: on a line that leads into the room, else in its middle."""
    inside = room.polygon.representative_point()
    ends = [shapely.Point(line.points[row]) for line in lines for row in (0, -1)]
    ends = [end for end in ends if room.polygon.distance(end) <= OPTIONS.same_point_m]
    if ends:
        return min(ends, key=inside.distance)
    through = [shapely.LineString(line.points) for line in lines]
    through = [line for line in through if line.intersects(room.polygon)]
    if through:
        nearest = min(through, key=inside.distance)
        return nearest.interpolate(nearest.project(inside))
    return inside


def _place_in(sketch: Sketch, room: Room, reach_m: float) -> Place | None:
    """Return the first landmark in a room, else the nearest one within reach of its outline."""
    away_m = [float(room.polygon.distance(shapely.Point(place.x, place.y))) for place in sketch.places]
    nearest = int(np.argmin(away_m)) if away_m else 0
    return sketch.places[nearest] if away_m and away_m[nearest] <= reach_m else None


def _stacked_ways(sketches: Sequence[Sketch], known: Sequence[Way]) -> Iterator[Way]:
    """Yield ways between rooms of one mode that lie above each other; a lift joins all its levels with each other."""
    told = {frozenset(way.rooms) for way in known if way.rooms is not None}
    shafts = nx.Graph()
    orders: dict[str, int] = {}
    for lower, upper in pairwise(sketches):
        for a, b in stacked_rooms(lower.rooms, upper.rooms, OPTIONS.min_overlap_ratio):
            orders |= {a.id: lower.order, b.id: upper.order}
            shafts.add_edge(a.id, b.id)
            if a.mode != "lift" and frozenset((a.id, b.id)) not in told:
                yield _between(str(a.mode), a.id, b.id, orders)
    rooms = {room.id: room for sketch in sketches for room in sketch.rooms}
    for part in nx.connected_components(shafts):
        members = sorted(part, key=lambda room_id: (orders[room_id], room_id))
        for one, other in combinations(members, 2):
            if (
                rooms[one].mode == "lift"
                and orders[one] < orders[other]
                and frozenset((one, other)) not in told
            ):
                yield _between("lift", one, other, orders)


def _between(mode: str, start: str, end: str, orders: dict[str, int]) -> Way:
    return Way(mode=mode, from_order=orders[start], to_order=orders[end], rooms=(start, end))


def _way_ends(sketch: Sketch, ways: Iterable[Way]) -> list[tuple[Points, str]]:
    """Return the points (2,) of a level where drawn ways begin or end, with their modes."""
    found = []
    for way in ways:
        if way.points is not None and way.from_order == sketch.order:
            found.append((way.points[0], way.mode))
        if way.points is not None and way.to_order == sketch.order:
            found.append((way.points[-1], way.mode))
    return found


def _add_links(sketch: Sketch, way_ends: Sequence[tuple[Points, str]]) -> None:
    """Give a level without walkable lines such lines; give loose ends and the ends of ways landmarks."""
    for point, mode in way_ends:
        _add_place(sketch, point, MODE_WORDS[mode])
    places = np.array([(place.x, place.y) for place in sketch.places]).reshape(-1, 2)
    if not sketch.lines:
        targets = np.unique(np.round(places, 4), axis=0)
        made = walkways(sketch.rooms, sketch.doors, targets, sketch.walls)
        sketch.lines = [Line(points=points) for points in made]
    for point in _loose_ends([line.points for line in sketch.lines], places):
        _add_place(sketch, point, "End of path")


def _add_place(sketch: Sketch, point: Points, word: str) -> None:
    """Add a landmark at a point, named after the room there, unless there is one already."""
    x, y = float(point[0]), float(point[1])
    if any(np.hypot(place.x - x, place.y - y) <= OPTIONS.same_point_m for place in sketch.places):
        return
    around = [room for room in sketch.rooms if room.name and room.polygon.intersects(shapely.Point(x, y))]
    room = min(around, key=lambda room: room.polygon.area, default=None)
    name, category = (word, None) if room is None else (room.name or word, room.category)
    sketch.places.append(Place(x=x, y=y, name=name, category=category))


def _loose_ends(lines: Sequence[Points], places: Points) -> Iterator[Points]:
    """Yield the ends of lines that touch no landmark and no other line."""
    marks = [shapely.Point(point) for point in places]
    tree = shapely.STRtree([*(shapely.LineString(line) for line in lines), *marks])
    for own, line in enumerate(lines):
        for end in (line[0], line[-1]):
            near = tree.query(shapely.Point(end), predicate="dwithin", distance=OPTIONS.same_point_m)
            if set(near.tolist()) <= {own}:
                yield end


class _LandmarkIds:
    """The ids of a level's places, and which of them stands in a room."""

    def __init__(self, sketch: Sketch) -> None:
        taken = {place.id for place in sketch.places if place.id is not None}
        self.by_place = [
            place.id or free_id(slug(place.name, place.category), taken) for place in sketch.places
        ]
        self._sketch = sketch

    def point_in(self, room_id: str) -> tuple[str, tuple[float, float]] | None:
        """Return the id and the position of the landmark in a room."""
        room = next((room for room in self._sketch.rooms if room.id == room_id), None)
        place = None if room is None else _place_in(self._sketch, room, OPTIONS.same_point_m)
        if place is None:
            return None
        return self.by_place[self._sketch.places.index(place)], (place.x, place.y)


def slug(name: str, category: str | None = None) -> str:
    """Return an id for a name: its Latin letters and digits, after the category where its letters are others."""
    words = _words(name)
    if not re.search("[a-z]", words) and (not words or any(map(str.isalpha, name))):
        words = "-".join(filter(None, (_words(category or ""), words)))
    return words or "place"


def _words(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", transliterated(text).lower()).strip("-")


def geojson_feature(kind: str, geometry: Any, /, **properties: object) -> GeoJson:
    """Return a GeoJSON feature of a kind; properties that are None are left out."""
    kept = {key: value for key, value in properties.items() if value is not None}
    return {"type": "Feature", "geometry": geometry, "properties": {**kept, "kind": kind}}


def _collection(
    sketch: Sketch, ways: Sequence[Way], landmarks: dict[int, _LandmarkIds], floors: dict[int, str]
) -> GeoJson:
    """Return the features of a level in plan metres."""
    found = [_area(room) for room in sketch.rooms if room.is_area]
    for place, own in zip(sketch.places, landmarks[sketch.order].by_place, strict=True):
        point = {"type": "Point", "coordinates": [place.x, place.y]}
        found.append(
            geojson_feature(place.kind, point, **{**place.properties, "id": own, "name": place.name})
        )
    known = [*(line.id for line in sketch.lines), *(way.id for way in ways)]
    taken = {own for own in known if own is not None}
    for line in sketch.lines:
        own = line.id or free_id("walk", taken)
        found.append(
            geojson_feature("link", _line(line.points), **{"mode": "walk", **line.properties, "id": own})
        )
    for way in ways:
        own = way.id or free_id(f"{way.mode}-to-{floors[way.to_order]}", taken)
        made = _way(way, landmarks, {"id": own, "to_floor": floors[way.to_order]})
        if made is not None:
            found.append(made)
    return {"type": "FeatureCollection", "features": found}


def _area(room: Room) -> GeoJson:
    outline = shapely.orient_polygons(room.polygon)
    rings = [
        np.round(shapely.get_coordinates(ring), 4).tolist() for ring in (outline.exterior, *outline.interiors)
    ]
    name = room.name or (MODE_WORDS[room.mode] if room.mode else room.category.replace(".", " ").capitalize())
    own = {"category": room.category, **room.properties, "id": room.id, "name": name}
    return geojson_feature("area", {"type": "Polygon", "coordinates": rings}, **own)


def _line(points: Points) -> GeoJson:
    return {"type": "LineString", "coordinates": np.round(points, 4).tolist()}


def _way(way: Way, landmarks: dict[int, _LandmarkIds], own: GeoJson) -> GeoJson | None:
    """Return the link of a way; None when a room that it joins has no landmark."""
    properties = {**way.properties, **own, "mode": way.mode}
    if way.points is not None:
        return geojson_feature("link", _line(way.points), **properties)
    if way.rooms is None:
        return None
    start, end = (
        landmarks[way.from_order].point_in(way.rooms[0]),
        landmarks[way.to_order].point_in(way.rooms[1]),
    )
    if start is None or end is None:
        return None
    line = _line(np.array([start[1], end[1]]))
    return geojson_feature("link", line, **{**properties, "from": start[0], "to": end[0]})
