"""Features of a floor in the database."""

from __future__ import annotations

from app.engine.floors.collection import parse_features, parse_json
from app.engine.floors.model import FloorFeatures
from app.engine.floors.reading import GeoJson
from app.engine.navigation.network import check_walkable
from app.services.resources import Resources
from app.storage.floors import get_features, get_floor, list_floors, set_features


def store_features(
    resources: Resources, venue_id: str, floor_id: str, collection: bytes | GeoJson
) -> FloorFeatures:
    """Check a floor's features and put them in place of those before; raises `InvalidInputError`,
    `NotFoundError`."""
    value = parse_json(collection) if isinstance(collection, bytes) else collection
    with resources.database.read() as connection:
        get_floor(connection, venue_id, floor_id)
        floors = list_floors(connection, venue_id)
    stored, features = parse_features(value, floor_id, [floor.id for floor in floors])
    check_walkable(features)
    with resources.database.write() as connection:
        set_features(connection, venue_id, floor_id, stored)
    return features


def stored_features(resources: Resources, venue_id: str, floor_id: str) -> GeoJson:
    """Return a floor's features as GeoJSON, none for a floor that was given none; raises `NotFoundError`."""
    with resources.database.read() as connection:
        return get_features(connection, venue_id, floor_id).collection
