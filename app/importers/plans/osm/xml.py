"""OSM XML: nodes, ways and multipolygon relations as elements. Documents with a DOCTYPE or entities are refused."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.importers.plans.osm.elements import Element

# A closed way with one of these tags is an area, unless it says area=no.
AREA_KEYS = (
    "indoor",
    "room",
    "stairs",
    "amenity",
    "shop",
    "office",
    "building",
    "building:part",
    "leisure",
    "tourism",
)


def is_osm_xml(name: str, data: bytes) -> bool:
    """Whether a file is OSM XML by its name or its beginning."""
    return name.lower().endswith(".osm") or b"<osm" in data[:1000]


@dataclass(slots=True)
class _Document:
    nodes: dict[str, tuple[float, float]] = field(default_factory=dict)
    ways: dict[str, list[str]] = field(default_factory=dict)
    members: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    tags: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)


def xml_elements(name: str, data: bytes) -> Iterator[Element]:
    """Yield the tagged elements of a document; raises `InvalidInputError`."""
    document = _parsed(name, data)
    for (kind, own), tags in document.tags.items():
        shape = _shape(document, kind, own, tags)
        if shape is not None:
            yield Element(f"{kind}/{own}", tags, shape)


def _parsed(name: str, data: bytes) -> _Document:
    document = _Document()
    current = ("", "")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal current
        if tag in ("node", "way", "relation"):
            current = tag, attributes["id"]
            if tag == "node":
                lon, lat = float(attributes["lon"]), float(attributes["lat"])
                if not (math.isfinite(lon) and math.isfinite(lat)):
                    raise ValueError(f"node {current[1]} has no place")
                document.nodes[current[1]] = lon, lat
            elif tag == "way":
                document.ways[current[1]] = []
            else:
                document.members[current[1]] = []
        elif tag == "tag":
            document.tags.setdefault(current, {})[attributes["k"]] = attributes["v"]
        elif tag == "nd":
            document.ways[current[1]].append(attributes["ref"])
        elif tag == "member" and attributes.get("type") == "way":
            document.members[current[1]].append((attributes["ref"], attributes.get("role", "")))

    def refuse(*_: object) -> None:
        raise InvalidInputError(f"{name} has a DOCTYPE or entities, which OSM XML doesn't need.")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, KeyError, ValueError) as error:
        raise InvalidInputError(f"{name} is no OSM XML that can be read: {error}.") from None
    document.tags.pop(("", ""), None)
    return document


def _shape(document: _Document, kind: str, own: str, tags: dict[str, str]) -> shapely.Geometry | None:
    """Return an element's shape; None for one whose nodes are not in the document."""
    if kind == "node":
        return shapely.Point(document.nodes[own])
    if kind == "way":
        line = _line(document, own)
        if line is None:
            return None
        is_area = tags.get("area") == "yes" or any(key in tags for key in AREA_KEYS)
        is_area = is_area and tags.get("area") != "no" and tags.get("indoor") != "wall"
        return shapely.Polygon(line.coords) if line.is_ring and is_area else line
    if tags.get("type") != "multipolygon":
        return None
    return _multipolygon(document, own)


def _line(document: _Document, own: str) -> shapely.LineString | None:
    points = [document.nodes[ref] for ref in document.ways.get(own, []) if ref in document.nodes]
    return shapely.LineString(points) if len(points) >= 2 else None


def _multipolygon(document: _Document, own: str) -> shapely.Geometry | None:
    parts = []
    for role in ("outer", "inner"):
        lines = [
            line
            for ref, its_role in document.members[own]
            if (its_role or "outer") == role and (line := _line(document, ref)) is not None
        ]
        parts.append(shapely.union_all(shapely.get_parts(shapely.polygonize(lines))))
    shape = parts[0].difference(parts[1])
    return None if shape.is_empty else shape
