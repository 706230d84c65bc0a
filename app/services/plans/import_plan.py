"""An indoor map of another format becomes a venue's floors and their features."""

from __future__ import annotations

from sqlalchemy import Connection

from app.engine.floors.collection import parse_features
from app.engine.floors.plan_alignment import parse_plan_from_world
from app.engine.navigation.network import check_walkable
from app.errors import InvalidInputError
from app.importers.plans.model import IndoorLevel, IndoorMap
from app.services.resources import Resources
from app.storage.floors import list_floors, put_floor, set_features
from app.storage.venues import create_venue, list_venues

STOREY_M = 3.5


def import_indoor_map(
    resources: Resources, venue_id: str, indoor_map: IndoorMap, storey_m: float = STOREY_M
) -> None:
    """Store an indoor map as a venue, all or nothing; the venue and floors are added where they are not there.

    A new floor has heights by `storey_m` unless the map knows them; a floor that is there keeps its own, with its
    plan. Raises `InvalidInputError` that names level and feature.
    """
    floor_ids = [level.id for level in indoor_map.levels]
    stored = {}
    for level in indoor_map.levels:
        try:
            stored[level.id], features = parse_features(level.features, level.id, floor_ids)
            check_walkable(features)
        except InvalidInputError as error:
            raise InvalidInputError(f"Level {level.id}: {error}") from None
    with resources.database.write() as connection:
        if venue_id not in [venue.id for venue in list_venues(connection)]:
            create_venue(connection, venue_id, indoor_map.name)
        known = {floor.id for floor in list_floors(connection, venue_id)}
        for level in indoor_map.levels:
            if level.id not in known:
                _add_floor(connection, venue_id, level, storey_m)
            set_features(connection, venue_id, level.id, stored[level.id])


def _add_floor(connection: Connection, venue_id: str, level: IndoorLevel, storey_m: float) -> None:
    low_m, high_m = level.heights_m or (level.order * storey_m, (level.order + 1) * storey_m)
    alignment = parse_plan_from_world(level.plan_from_world, high_m - low_m)
    put_floor(
        connection,
        venue_id,
        level.id,
        name=level.name,
        level=level.order,
        z_min_m=low_m,
        z_max_m=high_m,
        plan_from_world=None if alignment is None else alignment.matrix,
        plan_residual_m=None,
    )
