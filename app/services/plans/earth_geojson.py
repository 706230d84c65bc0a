"""A venue's features and plans as GeoJSON in longitude and latitude (RFC 7946)."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]
from shapely.geometry import mapping, shape  # type: ignore[import-untyped]
from sqlalchemy import Connection

from app.engine.floors.earth import Earth
from app.engine.floors.floor import Floor
from app.errors import ConflictError
from app.geometry.plan import plan_from_pixels
from app.services.resources import Resources
from app.storage.floors import get_features, get_floor, list_floors
from app.storage.venues import earth_of

GeoJson = dict[str, Any]
# A hundredth of a millimetre.
DECIMALS_DEG = 10
# How far the outer corner of a pixel is from its centre, in both directions.
HALF_PIXEL = 0.5


def floor_geojson(resources: Resources, venue_id: str, floor_id: str) -> GeoJson:
    """Return a floor's features in longitude and latitude.

    The member `origin`, there unless the plan has another size than that of the origin's floor, says how to read them
    as plan metres again. Raises `NotFoundError`, and `ConflictError` for a venue without an origin.
    """
    with resources.database.read() as connection:
        floor = get_floor(connection, venue_id, floor_id)
        earth = _earth(connection, venue_id)
        features = _features(connection, earth, floor)
    origin = earth.plan_origin(floor)
    return {
        "type": "FeatureCollection",
        **({} if origin is None else {"origin": origin}),
        "features": features,
    }


def venue_geojson(resources: Resources, venue_id: str) -> GeoJson:
    """Return the outlines of a venue's plan images and the features of its floors in longitude and latitude; raises as
    `floor_geojson`."""
    collected: list[GeoJson] = []
    with resources.database.read() as connection:
        earth = _earth(connection, venue_id)
        for floor in earth.floors:
            outline = _plan_outline(earth, floor)
            own = ([] if outline is None else [outline]) + _features(connection, earth, floor)
            place = {"floor": floor.id, "level": floor.level}
            collected += [{**feature, "properties": {**feature["properties"], **place}} for feature in own]
    return {"type": "FeatureCollection", "features": collected}


def digest_of(collection: GeoJson) -> str:
    """Return the digest of GeoJSON."""
    return hashlib.sha256(json.dumps(collection, sort_keys=True).encode()).hexdigest()


def _earth(connection: Connection, venue_id: str) -> Earth:
    earth = earth_of(connection, venue_id, list_floors(connection, venue_id))
    if earth is None:
        raise ConflictError(
            f"Venue {venue_id!r} has no place on Earth yet: PATCH /venues/{venue_id} sets its origin."
        )
    return earth


def _features(connection: Connection, earth: Earth, floor: Floor) -> list[GeoJson]:
    stored = get_features(connection, floor.venue_id, floor.id).collection
    return [
        {**feature, "geometry": _on_earth(earth, floor, shape(feature["geometry"]))}
        for feature in stored["features"]
    ]


def _plan_outline(earth: Earth, floor: Floor) -> GeoJson | None:
    """Return the outline of a floor's plan image, None for a floor without one."""
    plan = floor.plan
    if plan is None:
        return None
    right, lower = plan.width_px - HALF_PIXEL, plan.height_px - HALF_PIXEL
    u = np.array([-HALF_PIXEL, right, right, -HALF_PIXEL])
    v = np.array([-HALF_PIXEL, -HALF_PIXEL, lower, lower])
    corners_m = np.column_stack(plan_from_pixels(u, v, plan.meters_per_pixel, plan.origin_px))
    properties = {"kind": "plan", "name": floor.name, "corners": _degrees(earth, floor, corners_m).tolist()}
    geometry = _on_earth(earth, floor, shapely.Polygon(corners_m))
    return {"type": "Feature", "id": f"plan:{floor.id}", "geometry": geometry, "properties": properties}


def _on_earth(earth: Earth, floor: Floor, geometry: shapely.Geometry) -> GeoJson:
    """Return a geometry of a floor's plan in degrees, outer rings counter-clockwise as RFC 7946 wants."""
    moved = shapely.transform(geometry, lambda points: _degrees(earth, floor, points))
    return dict(mapping(shapely.orient_polygons(moved)))


def _degrees(earth: Earth, floor: Floor, points_m: Any) -> Any:
    return np.round(earth.geodetic_from_plan(floor, points_m), DECIMALS_DEG)
