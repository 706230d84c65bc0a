"""A small floor plan for tests: two rooms at a corridor, stairs and a lift up."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from app.engine.floors.floor import Floor
from tests.server import Server

Feature = dict[str, Any]
# A floor whose plan has the world's x and y.
IN_WORLD = Floor(
    venue_id="house",
    id="0",
    name="Ground",
    level=0,
    z_min_m=0.0,
    z_max_m=3.0,
    plan_from_world=np.eye(4),
    plan_residual_m=None,
    plan=None,
    features_sha256=None,
)
FLOORS = {
    "ground": {"name": "Ground floor", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0},
    "upper": {"name": "Upper floor", "level": 1, "z_min_m": 3.0, "z_max_m": 6.5},
}


def feature(geometry: str, coordinates: object, **properties: object) -> Feature:
    """Return a GeoJSON feature."""
    return {
        "type": "Feature",
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": properties,
    }


def landmark(landmark_id: str, x: float, y: float, name: str | None = None) -> Feature:
    """Return a landmark."""
    return feature("Point", [x, y], kind="landmark", id=landmark_id, name=name or landmark_id.title())


def link(*points: tuple[float, float], **properties: object) -> Feature:
    """Return a walk link, unless the properties say otherwise."""
    return feature("LineString", [list(point) for point in points], **{"kind": "link", **properties})


def area(area_id: str, x0: float, y0: float, x1: float, y1: float, **properties: object) -> Feature:
    """Return a rectangular area."""
    ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
    return feature(
        "Polygon", [ring], **{"kind": "area", "id": area_id, "name": area_id.title(), **properties}
    )


def collection(*features: Feature, **more: object) -> dict[str, Any]:
    """Return a FeatureCollection."""
    return {"type": "FeatureCollection", "features": list(features), **more}


GROUND = collection(
    area("kitchen", 0, 2, 4, 6, category="room"),
    area("office", 6, 2, 12, 6, category="room"),
    area("corridor", 0, 0, 20, 2),
    landmark("kitchen-door", 2, 1),
    landmark("office-door", 8, 1),
    landmark("desk", 8, 5),
    landmark("stairs", 18, 1),
    landmark("lift", 20, 1),
    feature("Point", [3, 5], kind="poi", id="stove", name="Stove"),
    link((2, 1), (8, 1), (18, 1), id="hall"),
    link((8, 1), (8, 5), id="to-desk", **{"from": "office-door", "to": "desk"}),
    link((18, 1), (20, 1), id="to-lift"),
    link((18, 1), (14, 1), id="stairs-up", mode="stairs", to_floor="upper", to="stairs"),
    feature("Point", [20, 1], kind="link", id="lift-up", mode="lift", to_floor="upper", to="lift"),
)
UPPER = collection(
    area("library", 0, 2, 12, 6),
    landmark("stairs", 14, 1),
    landmark("lift", 20, 1),
    landmark("shelf", 2, 5, "Book shelf"),
    link((20, 1), (14, 1), (2, 1), (2, 5), id="way"),
)


def put_features(server: Server, floor: str, value: object, venue: str = "site") -> Any:
    """Put features as they are: bytes unchanged, anything else as JSON, NaN and all."""
    content = value if isinstance(value, bytes) else json.dumps(value)
    return server.client.put(
        f"/venues/{venue}/floors/{floor}/features",
        content=content,
        headers={"Content-Type": "application/geo+json"},
    )


def add_floors(server: Server, venue: str = "site") -> None:
    """Add the venue and its two floors."""
    server.add_venue(venue)
    for floor, body in FLOORS.items():
        assert server.client.put(f"/venues/{venue}/floors/{floor}", json=body).status_code == 200


def add_plans(server: Server, venue: str = "site") -> None:
    """Add the venue, its floors and their features."""
    add_floors(server, venue)
    for floor, features in (("ground", GROUND), ("upper", UPPER)):
        answer = put_features(server, floor, features, venue)
        assert answer.status_code == 200, answer.text
