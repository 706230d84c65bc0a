"""Reads an IMDF archive: levels become floors, units areas, openings doors, and what people look for landmarks.

Source: OGC 20-094 (Indoor Mapping Data Format 1.0.0), the pages of the feature types.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.importers.plans.files import PlanFiles
from app.importers.plans.finish import finished, floor_ids
from app.importers.plans.frame import Frame, frame_from_json
from app.importers.plans.imdf import names
from app.importers.plans.imdf.archive import (
    OPTIONS,
    GeoJson,
    ImdfArchive,
    is_imdf,
    plan_points,
    polygons_of,
    properties_of,
)
from app.importers.plans.imdf.relationships import read_relationships
from app.importers.plans.model import Building, Door, IndoorMap, Place, Room, Sketch

# Feature types that say where things are, and are no things themselves.
STRUCTURE = ("address", "anchor", "building", "footprint", "venue")
LEFT_OUT = ("detail", "fixture", "geofence", "section")


def detect(files: PlanFiles) -> bool:
    """Whether the files are an IMDF archive."""
    return is_imdf(files)


def read(files: PlanFiles) -> IndoorMap:
    """Return the indoor map of an IMDF archive; raises `InvalidInputError` that names the feature."""
    return finished(_Reader(ImdfArchive(files), files.name).building())


class _Reader:
    """Reads the feature types one after the other; a feature that no level holds is counted as left out."""

    def __init__(self, archive: ImdfArchive, name: str) -> None:
        self._archive = archive
        self._name = name
        self._frame = _frame(archive)
        self._sketches: dict[int, Sketch] = {}
        self._frames: dict[int, Frame] = {}
        self._order_of_level: dict[str, int] = {}
        self._order_of_unit: dict[str, int] = {}
        self._left_out: Counter[str] = Counter()

    def building(self) -> Building:
        self._read_levels()
        for unit in self._archive.of_type("unit"):
            self._read_unit(unit)
        for opening in self._archive.of_type("opening"):
            self._read_opening(opening)
        for kind in ("amenity", "occupant", "kiosk"):
            for one in self._archive.of_type(kind):
                self._read_place(kind, one)
        for kind, count in self._archive.counts.items():
            if kind in LEFT_OUT or kind not in names.FEATURE_TYPES:
                self._left_out[kind] += count
        ways = read_relationships(
            self._archive,
            self._sketches,
            self._frames,
            {**self._order_of_level, **self._order_of_unit, **self._orders_of_amenities()},
            self._left_out,
        )
        venue = next(iter(self._archive.of_type("venue")), {})
        name = self._archive.label(properties_of(venue).get("name")) or self._name
        return Building(
            id=str(venue.get("id") or self._name),
            name=name,
            format="IMDF",
            sketches=list(self._sketches.values()),
            ways=ways,
            left_out=self._left_out,
            origin=_origin(self._frames[min(self._frames)]),
        )

    def _orders_of_amenities(self) -> dict[str, int]:
        found = {}
        for one in self._archive.of_type("amenity"):
            order = self._order(one)
            if order is not None:
                found[str(one.get("id"))] = order
        return found

    def _read_levels(self) -> None:
        groups: dict[int, list[GeoJson]] = {}
        for level in self._archive.of_type("level"):
            ordinal = properties_of(level).get("ordinal")
            if (
                isinstance(ordinal, bool)
                or not isinstance(ordinal, int | float)
                or not abs(ordinal) <= OPTIONS.max_ordinal
            ):
                raise InvalidInputError(
                    f"Level {level.get('id')} needs ordinal, a number within {OPTIONS.max_ordinal}."
                )
            if not float(ordinal).is_integer():
                raise InvalidInputError(f"Level {level.get('id')} needs a whole number as ordinal.")
            groups.setdefault(int(ordinal), []).append(level)
        if not groups:
            raise InvalidInputError("The archive has no level.")
        ids = floor_ids([self._ids(order, levels) for order, levels in sorted(groups.items())])
        for floor_id, (order, levels) in zip(ids, sorted(groups.items()), strict=True):
            self._read_level(floor_id, order, levels)

    def _ids(self, order: int, levels: list[GeoJson]) -> list[str]:
        own = [str(self._archive.own(level).get("floor") or "") for level in levels]
        short = [self._archive.label(properties_of(level).get("short_name")) or "" for level in levels]
        return [text for text in (*own, *short, str(order)) if text] + [f"level-{abs(order)}"]

    def _read_level(self, floor_id: str, order: int, levels: list[GeoJson]) -> None:
        inside = [level for level in levels if not properties_of(level).get("outdoor")] or levels
        own = self._archive.own(inside[0])
        heights = own.get("z_min_m"), own.get("z_max_m")
        labels = [self._archive.label(properties_of(level).get("name")) for level in inside]
        sketch = Sketch(
            order=order,
            id=floor_id,
            name=next(filter(None, labels), None) or f"Level {order}",
            is_complete=bool(own),
            heights_m=_heights(*heights),
            plan_from_world=own.get("plan_from_world"),
        )
        self._sketches[order] = sketch
        self._frames[order] = frame_from_json(own.get("origin")) or self._frame
        self._order_of_level |= {str(level.get("id")): order for level in levels}

    def _order(self, one: GeoJson) -> int | None:
        """Return the ordinal of the level that a feature is on."""
        properties = properties_of(one)
        level = self._archive.own(one).get("level_id") or properties.get("level_id")
        if level is not None:
            return self._order_of_level.get(str(level))
        units = properties.get("unit_ids") or [properties.get("unit_id")]
        found = [self._order_of_unit.get(str(unit)) for unit in units if unit is not None]
        return next((order for order in found if order is not None), None)

    def _read_unit(self, unit: GeoJson) -> None:
        order, properties = self._order(unit), properties_of(unit)
        own = self._archive.own(unit)
        unit_id, category = str(unit.get("id")), str(properties.get("category") or "unspecified")
        if order is None or category == "opentobelow":
            self._left_out["unit" if order is None else f"unit ({category})"] += 1
            return
        self._order_of_unit[unit_id] = order
        if own.get("generated"):
            return
        is_solid = category in names.SOLID_UNITS and not own
        if is_solid:
            self._left_out[f"unit ({category})"] += 1
        given = own.get("properties")
        kept = dict(given) if isinstance(given, Mapping) else {}
        parts = polygons_of(unit.get("geometry"), self._frames[order], f"Unit {unit_id}")
        for number, polygon in enumerate(parts):
            room = Room(
                id=str(kept.get("id") or unit_id) + (f"-{number + 1}" if number else ""),
                name=self._archive.label(properties.get("name")),
                category=category,
                polygon=polygon,
                mode=names.UNIT_MODES.get(category),
                is_walkable=category not in names.SOLID_UNITS | names.CLOSED_UNITS,
                is_open=category in names.OPEN_UNITS,
                is_area=not is_solid,
                properties={**kept, "category": kept.get("category")} if own else {},
            )
            self._sketches[order].rooms.append(room)

    def _read_opening(self, opening: GeoJson) -> None:
        order, geometry = self._order(opening), opening.get("geometry")
        if order is None or not isinstance(geometry, Mapping) or geometry.get("type") != "LineString":
            self._left_out["opening"] += 1
            return
        what = f"Opening {opening.get('id')}"
        points = plan_points(geometry.get("coordinates"), self._frames[order], what)
        if len(points) == 0:
            raise InvalidInputError(f"{what} has no valid coordinates.")
        middle = (
            shapely.LineString(points).interpolate(0.5, normalized=True) if len(points) > 1 else points[0]
        )
        x, y = (middle.x, middle.y) if isinstance(middle, shapely.Point) else middle
        properties = properties_of(opening)
        door = Door(
            x=float(x),
            y=float(y),
            name=self._archive.label(properties.get("name")),
            is_entrance=properties.get("category") in names.ENTRANCES,
        )
        self._sketches[order].doors.append(door)

    def _read_place(self, kind: str, one: GeoJson) -> None:
        place = self._placed(kind, one)
        if place is None:
            self._left_out[kind] += 1
            return
        order, (x, y) = place
        properties = properties_of(one)
        given = self._archive.own(one).get("properties")
        kept = dict(given) if isinstance(given, Mapping) else {}
        category = str(properties.get("category") or kind)
        name = self._archive.label(properties.get("name")) or category.replace(".", " ").capitalize()
        self._sketches[order].places.append(
            Place(
                x=x,
                y=y,
                name=name,
                id=str(kept["id"]) if "id" in kept else None,
                kind="poi" if kept.get("kind") == "poi" else "landmark",
                category=category,
                properties=kept or {"category": category},
            )
        )

    def _placed(self, kind: str, one: GeoJson) -> tuple[int, tuple[float, float]] | None:
        """Return the ordinal and the position of an amenity, a kiosk, or an occupant at its anchor."""
        properties = properties_of(one)
        source = self._archive.by_id.get(str(properties.get("anchor_id")), one) if kind == "occupant" else one
        order = self._order(source)
        if order is None:
            return None
        what = f"{kind.capitalize()} {one.get('id')}"
        geometry = source.get("geometry")
        if kind == "kiosk":
            point = properties.get("display_point")
            if not isinstance(point, Mapping):
                outline = next(polygons_of(geometry, self._frames[order], what), None)
                if outline is None:
                    return None
                inside = outline.representative_point()
                return order, (inside.x, inside.y)
            geometry = point
        if not isinstance(geometry, Mapping) or geometry.get("type") != "Point":
            return None
        x, y = plan_points([geometry.get("coordinates")], self._frames[order], what)[0]
        return order, (float(x), float(y))


def _origin(frame: Frame) -> tuple[float, float]:
    longitude, latitude = frame.geodetic_from_plan([(0.0, 0.0)])[0]
    return float(longitude), float(latitude)


def _heights(low: object, high: object) -> tuple[float, float] | None:
    if isinstance(low, int | float) and isinstance(high, int | float) and low < high:
        return float(low), float(high)
    return None


def _frame(archive: ImdfArchive) -> Frame:
    """Return the frame of a map whose levels name none: east and north of the venue's display point."""
    for venue in archive.of_type("venue"):
        point = properties_of(venue).get("display_point")
        for position in _positions(point.get("coordinates") if isinstance(point, Mapping) else None):
            return Frame(*position)
    found = [
        position
        for kind in ("level", "unit")
        for one in archive.of_type(kind)
        for position in _positions((one.get("geometry") or {}).get("coordinates"))
    ]
    if not found:
        raise InvalidInputError("The archive has no position on Earth: neither a display point nor outlines.")
    middle = np.array(found).mean(axis=0)
    return Frame(round(float(middle[0]), 7), round(float(middle[1]), 7))


def _positions(coordinates: Any) -> Iterator[tuple[float, float]]:
    """Yield all positions in nested coordinates."""
    if not isinstance(coordinates, list) or not coordinates:
        return
    if all(isinstance(number, int | float) and not isinstance(number, bool) for number in coordinates):
        if len(coordinates) >= 2:
            yield float(coordinates[0]), float(coordinates[1])
        return
    for inner in coordinates:
        yield from _positions(inner)
