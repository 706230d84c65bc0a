"""Elements of OpenStreetMap with their tags and shapes in longitude and latitude."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.importers.plans.files import PlanFiles, json_object

TAGS_OF_INDOOR_MAPS = ("highway", "door", "room", "stairs", "entrance")


@dataclass(frozen=True, slots=True)
class Element:
    """A tagged node, way or area; `shape` is a shapely Point, LineString, Polygon or MultiPolygon in degrees."""

    id: str
    tags: Mapping[str, str]
    shape: shapely.Geometry


def is_geojson(name: str, data: bytes) -> bool:
    """Whether a file is a GeoJSON FeatureCollection with indoor tags."""
    if not name.lower().endswith((".json", ".geojson")):
        return False
    try:
        entries = json_object(name, data).get("features")
    except InvalidInputError:
        return False
    return isinstance(entries, list) and any(_is_indoor(_tags(entry)) for entry in entries)


def _is_indoor(tags: Mapping[str, str]) -> bool:
    return "indoor" in tags or ("level" in tags and any(key in tags for key in TAGS_OF_INDOOR_MAPS))


def geojson_elements(files: PlanFiles) -> Iterator[Element]:
    """Yield the tagged features of all GeoJSON files; raises `InvalidInputError` that names the feature."""
    for name, data in sorted(files.contents.items()):
        entries = json_object(name, data).get("features")
        if not isinstance(entries, list):
            raise InvalidInputError(f"{name} must be a GeoJSON FeatureCollection.")
        for index, entry in enumerate(entries):
            tags = _tags(entry)
            if not tags:
                continue
            own = entry.get("id") or tags.get("@id") or f"feature/{index}"
            yield Element(str(own), tags, _shape(entry.get("geometry"), f"{name}: {own}"))


def _tags(entry: Any) -> dict[str, str]:
    """Return the tags of a feature, which converters write into its properties or into `tags` there."""
    properties = entry.get("properties") if isinstance(entry, Mapping) else None
    if not isinstance(properties, Mapping):
        return {}
    inside = properties.get("tags")
    source = inside if isinstance(inside, Mapping) else properties
    return {
        str(key): str(value)
        for key, value in source.items()
        if isinstance(value, str | int | float) and not isinstance(value, bool)
    }


def _shape(geometry: Any, what: str) -> shapely.Geometry:
    try:
        kind, coordinates = geometry["type"], geometry["coordinates"]
        if kind == "Point":
            return shapely.Point(_positions([coordinates])[0])
        if kind == "LineString":
            return shapely.LineString(_positions(coordinates))
        if kind == "MultiLineString" and len(coordinates) == 1:
            return shapely.LineString(_positions(coordinates[0]))
        parts = {"Polygon": [coordinates], "MultiPolygon": coordinates}[kind]
        polygons = [
            shapely.Polygon(_positions(rings[0]), [_positions(ring) for ring in rings[1:]]) for rings in parts
        ]
    except (KeyError, TypeError, ValueError, IndexError, shapely.errors.GEOSException):
        raise InvalidInputError(f"{what} has no geometry that can be read.") from None
    return polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)


def _positions(coordinates: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    positions = np.array([[float(x), float(y)] for x, y, *_ in coordinates], dtype=np.float64)
    if not np.isfinite(positions).all():
        raise ValueError("a position needs numbers")
    return positions
