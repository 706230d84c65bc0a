"""A small building in OpenStreetMap's Simple Indoor Tagging, written as OSM XML and as GeoJSON."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

from app.importers.plans.frame import Frame

FRAME = Frame(9.0, 48.0)
Xy = tuple[float, float]


@dataclass
class Drawing:
    """Nodes, ways and relations with points in metres."""

    nodes: dict[Xy, tuple[int, dict[str, str]]] = field(default_factory=dict)
    ways: list[tuple[list[Xy], dict[str, str]]] = field(default_factory=list)
    relations: list[tuple[list[tuple[int, str]], dict[str, str]]] = field(default_factory=list)

    def node(self, at: Xy, **tags: str) -> None:
        self.nodes[at] = len(self.nodes) + 1, tags

    def way(self, points: list[Xy], **tags: str) -> int:
        for at in points:
            if at not in self.nodes:
                self.node(at)
        self.ways.append((points, tags))
        return 100 + len(self.ways)

    def box(self, x: float, y: float, width: float, height: float, **tags: str) -> int:
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
        return self.way(corners, **tags)

    def xml(self) -> str:
        """Return the drawing as OSM XML."""
        rows = ['<?xml version="1.0"?>', '<osm version="0.6">']
        for at, (number, tags) in self.nodes.items():
            lon, lat = FRAME.geodetic_from_plan([at])[0]
            rows.append(f'<node id="{number}" lat="{lat:.10f}" lon="{lon:.10f}">{_tags(tags)}</node>')
        for number, (points, tags) in enumerate(self.ways, 101):
            members = "".join(f'<nd ref="{self.nodes[at][0]}"/>' for at in points)
            rows.append(f'<way id="{number}">{members}{_tags(tags)}</way>')
        for number, (ways, tags) in enumerate(self.relations, 501):
            members = "".join(f'<member type="way" ref="{way}" role="{role}"/>' for way, role in ways)
            rows.append(
                f'<relation id="{number}">{members}{_tags({"type": "multipolygon", **tags})}</relation>'
            )
        return "\n".join([*rows, "</osm>"])

    def geojson(self) -> str:
        """Return the tagged nodes and ways as GeoJSON, as converters write them."""
        features = []
        for at, (number, tags) in self.nodes.items():
            if tags:
                features.append(
                    _feature(f"node/{number}", "Point", FRAME.geodetic_from_plan([at])[0].tolist(), tags)
                )
        for number, (points, tags) in enumerate(self.ways, 101):
            line = FRAME.geodetic_from_plan(points).tolist()
            is_area = points[0] == points[-1] and tags.get("indoor") != "wall"
            shape = ("Polygon", [line]) if is_area else ("LineString", line)
            if tags:
                features.append(_feature(f"way/{number}", *shape, tags))
        return json.dumps({"type": "FeatureCollection", "features": features})


def _tags(tags: dict[str, str]) -> str:
    return "".join(f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in tags.items())


def _feature(own: str, kind: str, coordinates: object, tags: dict[str, str]) -> dict[str, object]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "id": own, "properties": {"@id": own, **tags}, "geometry": geometry}


def building() -> Drawing:
    """Return two storeys: an open hall and a corridor below, two rooms above, stairs and a lift between them.

    On the ground floor there is nothing to walk along; on the first floor there are footways.
    """
    made = Drawing()
    made.box(-2, -2, 40, 30, building="yes", name="Town hall")
    made.box(0, 0, 20, 10, indoor="area", level="0", name="Hall")
    made.box(20, 0, 10, 10, indoor="room", level="0", ref="101", room="office")
    made.node((20, 5), door="hinged")
    made.node((0, 5), entrance="main", level="0", name="West gate")
    made.way([(10, 0), (10, 7)], indoor="wall", level="0")
    made.node((4, 2), amenity="vending_machine", level="0")
    made.box(10, 10, 4, 4, indoor="room", stairs="yes", level="0;1", repeat_on="2")
    made.node((12, 10), door="no", level="0;1")
    made.node((11, 10), door="yes", level="0;1;2")
    made.node((16, 8), highway="elevator", level="0-1")
    made.way([(5, 8), (5, 3), (12, 3)], highway="steps", level="0;1", incline="down", conveying="forward")
    made.way([(5, 8), (16, 8), (11, 10)], highway="footway", level="1", wheelchair="no")
    made.way([(16, 8), (18, 8)], highway="corridor", level="1", oneway="yes")
    made.box(14, 4, 6, 6, indoor="room", level="1", name="Archive")
    made.box(5, 15, 2, 2, highway="steps", area="yes")
    made.box(2, 20, 2, 2, indoor="furniture", level="1")
    return made


def write_osm(target: Path, drawing: Drawing) -> Path:
    """Write a drawing in the format that the name says."""
    target.write_text(drawing.xml() if target.suffix == ".osm" else drawing.geojson(), encoding="utf-8")
    return target
