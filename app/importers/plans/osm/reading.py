"""Reads OpenStreetMap's Simple Indoor Tagging.

Rooms, areas and corridors become areas; doors and entrances join them; footways, corridors and steps that are drawn as
lines become links; walls drawn as lines are gone around. Source: the OpenStreetMap wiki, pages Simple Indoor Tagging,
Key:level, Key:repeat_on and Tag:highway=elevator.
"""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.importers.plans.files import PlanFiles
from app.importers.plans.finish import finished, floor_ids
from app.importers.plans.frame import Frame
from app.importers.plans.model import (
    MODE_WORDS,
    Building,
    Door,
    IndoorMap,
    Line,
    Place,
    Points,
    Room,
    Sketch,
    Way,
)
from app.importers.plans.osm.elements import Element, geojson_elements, is_geojson
from app.importers.plans.osm.levels import level_text, levels_of, orders_of
from app.importers.plans.osm.xml import is_osm_xml, xml_elements
from app.importers.plans.shapes import valid_parts
from app.limits import limit

WALKED = frozenset({"footway", "corridor", "path", "pedestrian", "steps"})
ROOMS = frozenset({"room", "area", "corridor", "elevator", "stairs"})
# What a room is, and what a point is that people look for.
CATEGORY_KEYS = ("room", "amenity", "shop", "office", "tourism", "leisure", "healthcare", "indoor")
PLACE_KEYS = (
    "amenity", "shop", "office", "tourism", "leisure", "healthcare", "emergency", "railway", "public_transport",
    "craft", "historic", "vending", "information",
)  # fmt: skip
NO = frozenset({"no", "private"})


@dataclass(frozen=True, slots=True, kw_only=True)
class OsmOptions:
    """How elements without a level or direction get one."""

    on_outline_m: float = limit(
        0.05,
        "A door without a level is on the levels of the rooms whose outlines are this near.",
        chosen="By hand: a door's node is a node of the outline, and converters round.",
    )
    far_m: float = limit(
        1_000.0,
        "Distance to a level that has nothing to walk on.",
        chosen="By hand: larger than any building, so that such levels decide nothing.",
    )


OPTIONS = OsmOptions()


def detect(files: PlanFiles) -> bool:
    """Whether one of the files is OSM XML or GeoJSON with indoor tags."""
    return any(is_osm_xml(*one) or is_geojson(*one) for one in files.contents.items())


def read(files: PlanFiles) -> IndoorMap:
    """Return the indoor map; raises `InvalidInputError`."""
    documents = {name: data for name, data in files.contents.items() if is_osm_xml(name, data)}
    elements = [element for one in documents.items() for element in xml_elements(*one)]
    if not documents:
        elements = list(geojson_elements(files))
    return finished(_Reader(elements, files.name).building())


class _Reader:
    """Sorts the elements by level and by what they become."""

    def __init__(self, elements: list[Element], name: str) -> None:
        self._elements = elements
        self._name = name
        indoor = [element for element in elements if levels_of(element.tags)]
        if not indoor:
            raise InvalidInputError("No element has a level: an indoor map of OpenStreetMap needs level=*.")
        centre = shapely.union_all([shapely.envelope(element.shape) for element in indoor]).centroid
        self._frame = Frame(round(centre.x, 7), round(centre.y, 7))
        levels = sorted({level for element in indoor for level in levels_of(element.tags)})
        labels = _level_labels(elements)
        ids = floor_ids([(labels.get(level, ("", ""))[0], level_text(level)) for level in levels])
        self._orders = orders_of(levels)
        self._sketches = {
            level: Sketch(
                order=self._orders[level], id=own, name=labels.get(level, ("", ""))[1] or f"Level {level:g}"
            )
            for level, own in zip(levels, ids, strict=True)
        }
        self._ways: list[Way] = []
        self._unsure: list[Way] = []
        self._left_out: Counter[str] = Counter()

    def building(self) -> Building:
        later = []
        for element in self._elements:
            levels = levels_of(element.tags)
            shape = shapely.transform(element.shape, self._frame.plan_from_geodetic)
            if _is_door(element.tags) and isinstance(shape, shapely.Point):
                later.append((element, levels, shape))
            elif element.tags.get("indoor") == "level":
                continue
            elif not levels or not self._read(element, levels, shape):
                self._left_out[_word(element.tags)] += 1
        for element, levels, shape in later:
            self._read_door(element, levels or self._levels_at(shape), shape)
        for way in self._unsure:
            self._direct(way)
        return Building(
            id=self._name,
            name=self._building_name(),
            format="OpenStreetMap",
            sketches=list(self._sketches.values()),
            ways=self._ways,
            left_out=self._left_out,
            origin=(self._frame.longitude, self._frame.latitude),
        )

    def _building_name(self) -> str:
        names = [one.tags["name"] for one in self._elements if "building" in one.tags and "name" in one.tags]
        return next(iter(names), self._name)

    def _read(self, element: Element, levels: list[float], shape: shapely.Geometry) -> bool:
        """Add an element to its levels; False for what has no meaning here."""
        tags = element.tags
        if tags.get("indoor") == "wall":
            lines = [shape] if isinstance(shape, shapely.LineString) else [shape.boundary]
            for level in levels:
                self._sketches[level].walls += [
                    line for line in lines if isinstance(line, shapely.LineString)
                ]
            return True
        if isinstance(shape, shapely.Polygon | shapely.MultiPolygon) and (
            tags.get("indoor") in ROOMS or _mode(tags)
        ):
            for level in levels:
                self._add_rooms(element, level, shape, is_repeated=len(levels) > 1)
            return True
        if isinstance(shape, shapely.LineString) and (
            tags.get("highway") in WALKED or tags.get("indoor") == "corridor"
        ):
            self._add_line(element, levels, shapely.get_coordinates(shape))
            return True
        if isinstance(shape, shapely.Point) and _mode(tags) == "lift":
            self._add_lift(element, levels, shape)
            return True
        return self._add_place(element, levels, shape)

    def _add_rooms(self, element: Element, level: float, shape: shapely.Geometry, is_repeated: bool) -> None:
        tags, mode = element.tags, _mode(element.tags)
        for number, polygon in enumerate(valid_parts(shape)):
            own = element.id + (f"@{level:g}" if is_repeated else "") + (f"-{number + 1}" if number else "")
            category = next((tags[key] for key in CATEGORY_KEYS if key in tags), "room")
            self._sketches[level].rooms.append(
                Room(
                    id=own,
                    name=_name(tags),
                    category=category.replace("_", " "),
                    polygon=polygon,
                    mode=mode,
                    is_walkable=tags.get("access") not in NO and tags.get("indoor") != "void",
                    is_open=tags.get("indoor") in ("area", "corridor"),
                )
            )

    def _add_line(self, element: Element, levels: list[float], points: Points) -> None:
        tags = element.tags
        conveying = tags.get("conveying", "no")
        oneway = tags.get("oneway:foot", tags.get("oneway", conveying))
        if oneway in ("-1", "backward"):
            points = points[::-1]
        properties: dict[str, object] = {
            "name": _name(tags),
            "one_way": oneway in ("yes", "-1", "forward", "backward"),
        }
        if tags.get("wheelchair") in ("yes", "no"):
            properties["accessible"] = tags["wheelchair"] == "yes"
        is_steps = tags.get("highway") == "steps"
        if len(levels) == 1:
            if is_steps:
                properties.setdefault("accessible", False)
            self._sketches[levels[0]].lines.append(Line(points=points, id=element.id, properties=properties))
            return
        mode = "escalator" if conveying not in NO else "stairs"
        incline = tags.get("incline", "")
        for number, (low, high) in enumerate(pairwise(levels)):
            way = Way(
                mode=mode,
                from_order=self._orders[low],
                to_order=self._orders[high],
                points=points,
                id=element.id + (f"-{number + 1}" if number else ""),
                properties=dict(properties),
            )
            self._ways.append(way)
            if incline.startswith(("down", "-")):
                self._turn(way)
            elif not incline.startswith(("up", "+")):
                self._unsure.append(way)

    def _add_lift(self, element: Element, levels: list[float], point: shapely.Point) -> None:
        for level in levels:
            self._sketches[level].places.append(
                Place(x=point.x, y=point.y, name=_name(element.tags) or MODE_WORDS["lift"])
            )
        at = np.array([(point.x, point.y)] * 2)
        for low, high in combinations(levels, 2):
            orders = self._orders[low], self._orders[high]
            own = f"{element.id}-{level_text(low)}-{level_text(high)}"
            self._ways.append(Way(mode="lift", from_order=orders[0], to_order=orders[1], points=at, id=own))

    def _add_place(self, element: Element, levels: list[float], shape: shapely.Geometry) -> bool:
        tags = element.tags
        kind = next((tags[key] for key in PLACE_KEYS if key in tags), None)
        name = _name(tags) or (None if kind is None else kind.replace("_", " ").capitalize())
        if name is None or (kind is None and not isinstance(shape, shapely.Point)):
            return False
        point = shape if isinstance(shape, shapely.Point) else shape.representative_point()
        properties = {} if kind is None else {"category": kind}
        for level in levels:
            place = Place(x=point.x, y=point.y, name=name, category=kind, properties=properties)
            self._sketches[level].places.append(place)
        return True

    def _read_door(self, element: Element, levels: Iterable[float], point: shapely.Point) -> None:
        tags = element.tags
        for level in levels:
            door = Door(
                x=point.x, y=point.y, name=_name(tags), is_entrance=tags.get("entrance", "no") != "no"
            )
            self._sketches[level].doors.append(door)

    def _levels_at(self, point: shapely.Point) -> list[float]:
        """Return the levels on which the outline of a room passes a door, which often has no level of its own."""
        return [
            level
            for level, sketch in self._sketches.items()
            if any(room.polygon.boundary.distance(point) <= OPTIONS.on_outline_m for room in sketch.rooms)
        ]

    def _direct(self, way: Way) -> None:
        """Let a way begin where its first level has something to walk on; without a sign of it, as it is drawn."""
        if way.points is None:
            return
        by_order = {sketch.order: sketch for sketch in self._sketches.values()}
        first, last = by_order[way.from_order], by_order[way.to_order]
        ends = [shapely.Point(way.points[0]), shapely.Point(way.points[-1])]
        as_drawn = _away_m(first, ends[0]) + _away_m(last, ends[1])
        turned = _away_m(first, ends[1]) + _away_m(last, ends[0])
        if turned < as_drawn:
            self._turn(way)

    def _turn(self, way: Way) -> None:
        """Exchange the levels of a way, and keep the direction in which it is drawn and walked."""
        way.from_order, way.to_order = way.to_order, way.from_order


def _away_m(sketch: Sketch, point: shapely.Point) -> float:
    """Return how far the nearest line of a level is, or its nearest room where it has no lines."""
    shapes = [shapely.LineString(line.points) for line in sketch.lines] or [
        room.polygon for room in sketch.rooms
    ]
    return min((float(shape.distance(point)) for shape in shapes), default=OPTIONS.far_m)


def _is_door(tags: Mapping[str, str]) -> bool:
    return (
        tags.get("door", "no") != "no" or tags.get("entrance", "no") != "no" or tags.get("indoor") == "door"
    )


def _mode(tags: Mapping[str, str]) -> str | None:
    """Return how an element leads to other levels."""
    if tags.get("conveying", "no") != "no" and ("stairs" in tags or "indoor" in tags):
        return "escalator"
    if tags.get("stairs", "no") != "no" or tags.get("room") in ("stairs", "stairwell"):
        return "stairs"
    is_lift = tags.get("highway") == "elevator" or "elevator" in (tags.get("room"), tags.get("indoor"))
    return "lift" if is_lift else None


def _name(tags: Mapping[str, str]) -> str | None:
    text = " ".join((tags.get("name") or tags.get("ref") or "").split())[:200]
    # What joins the letters of a script isn't printable, and belongs to names.
    is_line = not any(unicodedata.category(character) in ("Cc", "Cs") for character in text)
    return text if is_line and any(map(str.isprintable, text)) else None


def _word(tags: Mapping[str, str]) -> str:
    """Return what an element that is left out is called in the report."""
    if not levels_of(tags):
        return "without level"
    keys = ("indoor", "highway", "building", "building:part", "barrier", "furniture")
    return next((f"{key}={tags[key]}" for key in keys if key in tags), "other")[:60]


def _level_labels(elements: Iterable[Element]) -> dict[float, tuple[str, str]]:
    """Return the short and the long name of levels that an element `indoor=level` describes."""
    found = {}
    for element in elements:
        if element.tags.get("indoor") == "level":
            for level in levels_of(element.tags):
                short = element.tags.get("level:ref") or element.tags.get("ref") or ""
                found[level] = short, element.tags.get("name") or short
    return found
