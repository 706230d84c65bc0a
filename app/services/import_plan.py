"""An indoor map of another format becomes a venue's floors and their features."""

from __future__ import annotations

from app.engine.floors.collection import parse_features
from app.engine.navigation.network import check_walkable
from app.importers.wrld_indoor_map import IndoorMap
from app.services.resources import Resources
from app.storage.floors import list_floors, put_floor, set_features
from app.storage.venues import create_venue, list_venues

STOREY_M = 3.5


def import_indoor_map(
    resources: Resources, venue_id: str, indoor_map: IndoorMap, storey_m: float = STOREY_M
) -> None:
    """Store an indoor map as a venue, all or nothing; the venue and floors are added where they are not there.

    A new floor has heights by `storey_m`, for the format has none; a floor that is there keeps its own, with its
    plan. Raises `InvalidInputError` that names level and feature.
    """
    floor_ids = [level.id for level in indoor_map.levels]
    stored = {}
    for level in indoor_map.levels:
        stored[level.id], features = parse_features(level.features, level.id, floor_ids)
        check_walkable(features)
    with resources.database.write() as connection:
        if venue_id not in [venue.id for venue in list_venues(connection)]:
            create_venue(connection, venue_id, indoor_map.name)
        known = {floor.id for floor in list_floors(connection, venue_id)}
        for level in indoor_map.levels:
            if level.id not in known:
                put_floor(
                    connection,
                    venue_id,
                    level.id,
                    name=level.name,
                    level=level.order,
                    z_min_m=level.order * storey_m,
                    z_max_m=(level.order + 1) * storey_m,
                    plan_from_world=None,
                    plan_residual_m=None,
                )
            set_features(connection, venue_id, level.id, stored[level.id])
