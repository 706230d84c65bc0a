"""The features of an IMDF archive made from a venue's floors.

Source: OGC 20-094 (Indoor Mapping Data Format 1.0.0), the pages of the feature types. What the format has no member
for, such as a link's `accessible`, stands in a property of our own, which a declared extension allows.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.engine.floors.collection import read_collection
from app.engine.floors.floor import Floor
from app.engine.floors.model import Area, FloorFeatures, Landmark, Link
from app.engine.floors.places import PlaceIndex
from app.importers.plans.frame import Frame
from app.importers.plans.imdf.names import CATEGORY_OF_MODE, OWN, UNIT_CATEGORIES, UNIT_MODES
from app.limits import limit

GeoJson = dict[str, Any]
# A hundredth of a millimetre.
DECIMALS_DEG = 10
CATEGORY_OF_UNIT = {mode: category for category, mode in UNIT_MODES.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ImdfWriterOptions:
    """What is made up where a venue holds nothing of the kind."""

    margin_m: float = limit(
        1.0,
        "The outline of a level lies this far around what is on it.",
        chosen="By hand: outer walls, and a place for a landmark at a door.",
    )


OPTIONS = ImdfWriterOptions()


@dataclass(frozen=True, slots=True)
class PlacedFloor:
    """A floor, where its plan lies on Earth, and its features as they are stored."""

    floor: Floor
    frame: Frame
    collection: GeoJson


class ImdfWriter:
    """Makes the features by type. Ids are the same for the same venue, floor and feature."""

    def __init__(self, venue_id: str, name: str, language: str) -> None:
        self._venue_id, self._name, self._language = venue_id, name, language
        self._types: dict[str, list[GeoJson]] = {}

    def write(
        self, floors: Sequence[PlacedFloor], address: GeoJson, category: str
    ) -> dict[str, list[GeoJson]]:
        """Return the features by type."""
        kinds = (
            "address",
            "venue",
            "building",
            "footprint",
            "level",
            "unit",
            "amenity",
            "opening",
            "relationship",
        )
        self._types = {kind: [] for kind in kinds}
        outlines = []
        levels = {one.floor.id: self.id_of("level", one.floor.id) for one in floors}
        for one in floors:
            features = read_collection(one.collection, one.floor.id)[1]
            outline = _outline(features)
            outlines.append(shapely.Polygon(one.frame.geodetic_from_plan(outline.exterior.coords)))
            self._write_level(one, outline)
            _FloorWriter(self, one, features, levels).write(outline)
        self._write_venue(shapely.union_all(outlines).convex_hull, address, category)
        return self._types

    def id_of(self, *names: str) -> str:
        """Return a UUID of version 4's form that depends on the names alone."""
        digest = hashlib.sha256("\0".join((self._venue_id, *names)).encode()).digest()
        return str(uuid.UUID(bytes=digest[:16], version=4))

    def add(self, kind: str, geometry: GeoJson | None, properties: GeoJson, *names: str) -> str:
        """Add a feature and return its id."""
        own = self.id_of(kind, *names)
        self._types[kind].append(
            {
                "id": own,
                "type": "Feature",
                "feature_type": kind,
                "geometry": geometry,
                "properties": properties,
            }
        )
        return own

    def labels(self, text: str | None) -> dict[str, str] | None:
        """Return a text as labels."""
        return None if text is None else {self._language: text}

    def _write_venue(self, outline: shapely.Polygon, address: GeoJson, category: str) -> None:
        geometry, middle = _polygon(outline), _point(np.array(outline.representative_point().coords)[0])
        address_id = self.add("address", None, address)
        common = {"restriction": None, "alt_name": None, "display_point": middle, "address_id": address_id}
        name = self.labels(self._name)
        more = {"hours": None, "website": None, "phone": None}
        self.add("venue", geometry, {"category": category, "name": name, **common, **more})
        building = self.add("building", None, {"category": "unspecified", "name": name, **common})
        footprint = {"category": "ground", "name": None, "building_ids": [building]}
        self.add("footprint", geometry, footprint)
        for level in self._types["level"]:
            level["properties"] |= {"address_id": address_id, "building_ids": [building]}

    def _write_level(self, one: PlacedFloor, outline: shapely.Polygon) -> None:
        floor = one.floor
        matrix = None if floor.plan_from_world is None else floor.plan_from_world.tolist()
        own = {
            "floor": floor.id,
            "z_min_m": floor.z_min_m,
            "z_max_m": floor.z_max_m,
            "plan_from_world": matrix,
            "origin": one.frame.as_json(),
        }
        properties = {
            "category": "unspecified",
            "restriction": None,
            "outdoor": False,
            "ordinal": floor.level,
            "name": self.labels(floor.name),
            "short_name": self.labels(floor.id),
            "display_point": _point(one.frame.geodetic_from_plan(outline.centroid.coords)[0]),
            OWN: own,
        }
        geometry = _polygon(_on_earth(outline, one.frame))
        self.add("level", geometry, properties, floor.id)


class _FloorWriter:
    """Writes what is on one floor."""

    def __init__(
        self, writer: ImdfWriter, one: PlacedFloor, features: FloorFeatures, levels: dict[str, str]
    ) -> None:
        self._writer, self._frame, self._features = writer, one.frame, features
        self._floor_id, self._levels = one.floor.id, levels
        self._places = PlaceIndex(features)
        self._units: dict[str, str] = {}
        self._rest: str | None = None
        stored = one.collection["features"]
        self._stored = {
            (entry["properties"]["kind"], entry["properties"]["id"]): entry["properties"] for entry in stored
        }

    def write(self, outline: shapely.Polygon) -> None:
        for area in self._features.areas:
            self._write_area(area)
        for kind, group in (("landmark", self._features.landmarks), ("poi", self._features.pois)):
            for mark in group.values():
                self._write_mark(kind, mark, outline)
        for link in self._features.links:
            self._write_link(link)

    def _own(self, kind: str, feature_id: str) -> GeoJson:
        return {"level_id": self._levels[self._floor_id], "properties": self._stored[kind, feature_id]}

    def _write_area(self, area: Area) -> None:
        category = (area.category or "").lower()
        category = CATEGORY_OF_UNIT.get(category, category)
        properties = {
            **self._unit(category if category in UNIT_CATEGORIES else "unspecified", area.polygon),
            "name": self._writer.labels(area.name),
            OWN: self._own("area", area.id),
        }
        geometry = _polygon(_on_earth(area.polygon, self._frame))
        self._units[area.id] = self._writer.add("unit", geometry, properties, self._floor_id, area.id)

    def _unit(self, category: str, polygon: shapely.Geometry) -> GeoJson:
        middle = self._frame.geodetic_from_plan(polygon.representative_point().coords)[0]
        return {
            "category": category,
            "restriction": None,
            "accessibility": None,
            "name": None,
            "alt_name": None,
            "level_id": self._levels[self._floor_id],
            "display_point": _point(middle),
        }

    def _rest_of_floor(self, outline: shapely.Polygon) -> str:
        """Return the id of the unit that is what the areas leave of the floor: an amenity must be in a unit."""
        if self._rest is None:
            rest = outline.difference(shapely.union_all([area.polygon for area in self._features.areas]))
            rest = outline if rest.is_empty else rest
            properties = {**self._unit("walkway", rest), OWN: {"generated": True}}
            geometry = _polygon(_on_earth(rest, self._frame))
            self._rest = self._writer.add("unit", geometry, properties, self._floor_id, "\0rest")
        return self._rest

    def _write_mark(self, kind: str, mark: Landmark, outline: shapely.Polygon) -> None:
        area = self._places.area(mark.x, mark.y)
        unit = self._rest_of_floor(outline) if area is None else self._units[area.id]
        properties = {
            "category": "landmark" if kind == "landmark" else "unspecified",
            "accessibility": None,
            "name": self._writer.labels(mark.name),
            "alt_name": None,
            "hours": None,
            "phone": None,
            "website": None,
            "unit_ids": [unit],
            "address_id": None,
            "correlation_id": None,
            OWN: self._own(kind, mark.id),
        }
        geometry = _point(self._frame.geodetic_from_plan([(mark.x, mark.y)])[0])
        self._writer.add("amenity", geometry, properties, self._floor_id, mark.id)

    def _write_link(self, link: Link) -> None:
        own = self._own("link", link.id)
        to_floor = link.to_floor or self._floor_id
        if to_floor in self._levels:
            own["to_level_id"] = self._levels[to_floor]
        properties = {
            "category": CATEGORY_OF_MODE[link.mode],
            "direction": "directed" if link.one_way else "undirected",
            "origin": self._reference(self._floor_id, link.start),
            "intermediary": None,
            "destination": self._reference(to_floor, link.end),
            "hours": None,
            OWN: own,
        }
        line = self._frame.geodetic_from_plan(link.points)
        # A way between floors may be drawn as a point, which stands in a link twice.
        is_point = bool((link.points == link.points[0]).all())
        geometry = (
            _point(line[0])
            if is_point
            else {"type": "LineString", "coordinates": np.round(line, DECIMALS_DEG).tolist()}
        )
        self._writer.add("relationship", geometry, properties, self._floor_id, link.id)

    def _reference(self, floor_id: str, landmark: str | None) -> GeoJson | None:
        """Return the reference to a link's end: its landmark, else the level."""
        if landmark is not None:
            return {"id": self._writer.id_of("amenity", floor_id, landmark), "feature_type": "amenity"}
        level = self._levels.get(floor_id)
        return None if level is None else {"id": level, "feature_type": "level"}


def _outline(features: FloorFeatures) -> shapely.Polygon:
    """Return the outline of all that is on a floor, in plan metres."""
    marks = [shapely.Point(m.x, m.y) for group in (features.landmarks, features.pois) for m in group.values()]
    lines = [shapely.LineString(link.points) for link in features.links]
    shapes = [*(area.polygon for area in features.areas), *marks, *lines] or [shapely.Point(0, 0)]
    return shapely.union_all(shapes).convex_hull.buffer(OPTIONS.margin_m, join_style="mitre")


def _on_earth(shape: shapely.Geometry, frame: Frame) -> shapely.Geometry:
    return shapely.transform(shape, frame.geodetic_from_plan)


def _polygon(shape: shapely.Geometry) -> GeoJson:
    """Return a polygon in degrees as GeoJSON, its outer ring counter-clockwise as RFC 7946 wants."""
    parts = [
        [_ring(ring) for ring in (part.exterior, *part.interiors)]
        for part in shapely.get_parts(shapely.orient_polygons(shape))
    ]
    if len(parts) == 1:
        return {"type": "Polygon", "coordinates": parts[0]}
    return {"type": "MultiPolygon", "coordinates": parts}


def _ring(ring: shapely.LinearRing) -> list[list[float]]:
    rounded: list[list[float]] = np.round(shapely.get_coordinates(ring), DECIMALS_DEG).tolist()
    return rounded


def _point(position: Any) -> GeoJson:
    return {"type": "Point", "coordinates": np.round(position, DECIMALS_DEG).tolist()}
