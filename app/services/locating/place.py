"""The place that a query is asked of: a venue with its floors and map, and where in it the query says it is."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.floors.earth import Earth
from app.engine.floors.floor import Floor
from app.engine.query.narrowing import AreaOnFloor
from app.errors import InvalidInputError
from app.services.floor_features import FeatureLibrary
from app.services.locate_result import LocateRequest
from app.storage.db import Database
from app.storage.floors import get_floor, list_floors
from app.storage.maps import MapVersion, active_version
from app.storage.venues import earth_of, list_venues


@dataclass(frozen=True, slots=True, kw_only=True)
class QueryPlace:
    """A venue as a query finds it: its floors, the map version that serves it and its place on Earth, if any; and the
    floor and the areas that the query names, None where it names none."""

    venue: str
    floors: list[Floor]
    version: MapVersion | None
    earth: Earth | None
    floor: Floor | None
    areas: list[AreaOnFloor] | None


def place_of(database: Database, features: FeatureLibrary, request: LocateRequest) -> QueryPlace:
    """Return the place that a query is asked of.

    Raises `NotFoundError` for an unknown venue, floor or area, `InvalidInputError` for a query that names no venue,
    unless there is exactly one.
    """
    with database.read() as connection:
        venue = request.venue
        if venue is None:
            venues = list_venues(connection)
            if len(venues) != 1:
                raise InvalidInputError(
                    f"There are {len(venues)} venues: say in the field venue which one the image is from."
                )
            venue = venues[0].id
        floor = None if request.floor is None else get_floor(connection, venue, request.floor)
        floors = list_floors(connection, venue)
        earth = earth_of(connection, venue, floors)
        version = active_version(connection, venue)
    areas = None
    if request.area is not None:
        areas = features.areas(floors if floor is None else [floor], request.area)
    return QueryPlace(venue=venue, floors=floors, version=version, earth=earth, floor=floor, areas=areas)
