"""Relationships of an IMDF archive: those with a line are links, those between units of two levels are ways."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from app.importers.plans.frame import Frame
from app.importers.plans.imdf import names
from app.importers.plans.imdf.archive import GeoJson, ImdfArchive, plan_points, properties_of, reference
from app.importers.plans.model import Line, Points, Sketch, Way


def read_relationships(
    archive: ImdfArchive,
    sketches: Mapping[int, Sketch],
    frames: Mapping[int, Frame],
    orders: Mapping[str, int],
    left_out: Counter[str],
) -> list[Way]:
    """Add the walkable lines to their levels and return the ways between levels.

    `orders` are the ordinals of the levels that features are on, by the features' ids.
    """
    ways: list[Way] = []
    reader = _Relationships(archive, frames, orders)
    for one in archive.of_type("relationship"):
        found = reader.read(one)
        if isinstance(found, tuple):
            sketches[found[0]].lines.append(found[1])
        elif found:
            ways += found
        else:
            left_out["relationship"] += 1
    return ways


class _Relationships:
    def __init__(self, archive: ImdfArchive, frames: Mapping[int, Frame], orders: Mapping[str, int]) -> None:
        self._archive, self._frames, self._orders = archive, frames, orders

    def read(self, one: GeoJson) -> tuple[int, Line] | list[Way]:
        """Return a line with the ordinal of its level, or ways; no way for what says nothing about walking."""
        properties, own = properties_of(one), self._archive.own(one)
        members = [reference(properties.get("origin"))]
        between = properties.get("intermediary")
        members += map(reference, between if isinstance(between, list) else [])
        members.append(reference(properties.get("destination")))
        start = self._order(own.get("level_id"), members[0])
        end = self._order(own.get("to_level_id"), members[-1])
        kept = self._link_properties(properties, own)
        geometry = one.get("geometry")
        if start is not None and isinstance(geometry, Mapping):
            points = self._points(geometry, start, f"Relationship {one.get('id')}")
            if len(points) >= 2:
                return self._drawn(points, start, end, kept, properties)
        known = [member for member in members if member is not None and member in self._orders]
        return self._ways(known, kept, properties)

    def _points(self, geometry: GeoJson, order: int, what: str) -> Points:
        """Return a line's points (n, 2) in plan metres, a Point's twice, and none of other geometries."""
        coordinates, kind = geometry.get("coordinates"), geometry.get("type")
        if kind == "LineString":
            return plan_points(coordinates, self._frames[order], what)
        return plan_points([coordinates] * 2 if kind == "Point" else [], self._frames[order], what)

    def _order(self, level_id: object, member: str | None) -> int | None:
        order = None if level_id is None else self._orders.get(str(level_id))
        return self._orders.get(str(member)) if order is None else order

    def _link_properties(self, properties: GeoJson, own: Mapping[str, Any]) -> dict[str, Any]:
        given = own.get("properties")
        kept = dict(given) if isinstance(given, Mapping) else {}
        kept.setdefault("one_way", properties.get("direction") == "directed")
        if properties.get("category") == "ramp":
            kept.setdefault("accessible", True)
        return kept

    def _drawn(
        self, points: Points, start: int, end: int | None, kept: dict[str, Any], properties: GeoJson
    ) -> tuple[int, Line] | list[Way]:
        own_id = str(kept["id"]) if "id" in kept else None
        mode = str(kept.get("mode") or names.MODES.get(str(properties.get("category")), "walk"))
        if end is None or end == start:
            return start, Line(points=points, id=own_id, properties={**kept, "mode": "walk"})
        mode = "stairs" if mode == "walk" else mode
        way = Way(mode=mode, from_order=start, to_order=end, points=points, id=own_id, properties=kept)
        return [way]

    def _ways(self, members: list[str], kept: dict[str, Any], properties: GeoJson) -> list[Way]:
        """Return a way for each change of level along the units that a relationship names."""
        mode = names.MODES.get(str(properties.get("category")))
        units = [member for member in members if self._archive.by_id[member].get("feature_type") == "unit"]
        if mode is None:
            return []
        return [
            Way(
                mode=mode, from_order=self._orders[a], to_order=self._orders[b], rooms=(a, b), properties=kept
            )
            for a, b in pairwise(units)
            if self._orders[a] != self._orders[b]
        ]
