"""Venues."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from pydantic import BaseModel, ConfigDict, Field, model_validator
from starlette.routing import Match
from starlette.types import Scope

from app.api.bodies.earth import ORIGIN, OriginBody
from app.api.bodies.geojson import MEDIA_TYPE, VENUE_EXAMPLE, GeoJsonResponse, VenueFeatureCollection
from app.api.deps import ID_PATTERN, CallerOf, State, VenueId, require
from app.api.requests.conditional import NOT_MODIFIED, unless_known
from app.api.requests.contract_route import ContractRoute
from app.api.requests.fields import FIELDS, NAME_PATTERN
from app.api.requests.json_body import RequestBody
from app.api.requests.paging import Paged
from app.api.schemas import problems
from app.services.plans.earth_geojson import digest_of, venue_geojson
from app.storage.sweep import discard_blobs, venue_blobs
from app.storage.venues import (
    RESERVED_IDS,
    Venue,
    create_venue,
    delete_venue,
    get_venue,
    list_venues,
    place_venue,
    rename_venue,
)


class VenueRoute(ContractRoute):
    """A route of a venue's own address: a reserved id there is the address of another route."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Return whether the route serves a request."""
        match, found = super().matches(scope)
        if found.get("path_params", {}).get("venue") in RESERVED_IDS:
            return Match.NONE, {}
        return match, found


router = APIRouter(prefix="/venues", tags=["venues"], route_class=VenueRoute)
Name = Annotated[str, Field(min_length=1, max_length=FIELDS.max_name_characters, pattern=NAME_PATTERN)]


class NewVenue(RequestBody):
    """A venue to add."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"id": "museum", "name": "City museum", "origin": ORIGIN}}
    )

    id: str = Field(pattern=ID_PATTERN, json_schema_extra={"not": {"enum": list(RESERVED_IDS)}})
    name: Name
    origin: OriginBody | None = Field(None, description="Where on Earth it lies")


class VenueChange(RequestBody):
    """What can be changed of a venue; what is left out stays as it is."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"name": "City museum, new wing", "origin": ORIGIN},
            "minProperties": 1,
        }
    )

    name: Name = ""
    origin: OriginBody | None = Field(None, description="Where on Earth it lies; null takes that away")

    @model_validator(mode="after")
    def _says_something(self) -> VenueChange:
        if not self.model_fields_set:
            raise ValueError("give name, origin or both")
        return self


class VenueBody(BaseModel):
    """A venue; `map_version` is the map that serves it, null before the first build."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": "museum",
                "name": "City museum",
                "created_at": "2026-03-01T09:00:00Z",
                "map_version": 3,
                "origin": ORIGIN,
            }
        }
    )

    id: str
    name: str
    created_at: datetime
    map_version: int | None
    origin: OriginBody | None = Field(
        None, description="Where on Earth it lies, null where that is not known"
    )


def _body(venue: Venue) -> VenueBody:
    return VenueBody(
        id=venue.id,
        name=venue.name,
        created_at=venue.created_at,
        map_version=venue.active_map_version,
        origin=None if venue.origin is None else OriginBody.of(venue.origin),
    )


@router.post(
    "",
    name="createVenue",
    status_code=201,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 409, 422),
)
def create(state: State, caller: CallerOf, venue: NewVenue) -> VenueBody:
    """Add a venue."""
    caller.check_venue(None)
    with state.services.resources.database.write() as connection:
        created = create_venue(connection, venue.id, venue.name)
        if venue.origin is not None:
            created = place_venue(connection, venue.id, venue.origin.to_origin())
        return _body(created)


@router.get("", name="listVenues", dependencies=[Depends(require("locate"))], responses=problems(401, 422))
def list_all(state: State, caller: CallerOf, page: Paged) -> list[VenueBody]:
    """List the venues that the key may use."""
    with state.services.resources.database.read() as connection:
        venues = list_venues(connection)
    allowed = [venue for venue in venues if caller.venue_id in (None, venue.id)]
    return [_body(venue) for venue in page.of(allowed, lambda venue: venue.id)]


@router.get(
    "/{venue}", name="getVenue", dependencies=[Depends(require("locate"))], responses=problems(401, 404, 422)
)
def get(state: State, venue: VenueId) -> VenueBody:
    """Return a venue."""
    with state.services.resources.database.read() as connection:
        return _body(get_venue(connection, venue))


@router.patch(
    "/{venue}",
    name="changeVenue",
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def change(state: State, venue: VenueId, change: VenueChange) -> VenueBody:
    """Change a venue's name, or where on Earth it lies."""
    with state.services.resources.database.write() as connection:
        changed = get_venue(connection, venue)
        if "name" in change.model_fields_set:
            changed = rename_venue(connection, venue, change.name)
        if "origin" in change.model_fields_set:
            origin = None if change.origin is None else change.origin.to_origin()
            changed = place_venue(connection, venue, origin)
        return _body(changed)


@router.get(
    "/{venue}/geojson",
    name="getVenueGeojson",
    dependencies=[Depends(require("locate"))],
    responses={
        200: {"content": {MEDIA_TYPE: {"example": VENUE_EXAMPLE}}},
        **NOT_MODIFIED,
        **problems(401, 404, 409, 422),
    },
    response_model=VenueFeatureCollection,
    response_class=GeoJsonResponse,
)
def geojson(state: State, venue: VenueId, request: Request) -> Response:
    """Return a venue's plans and features in longitude and latitude.

    Each feature says its `floor` and `level`; the outline of a plan image has the kind `plan` and in `corners` the
    image's upper left, upper right, lower right and lower left corner. It needs the venue's origin.
    """
    on_earth = venue_geojson(state.services.resources, venue)
    return unless_known(request, digest_of(on_earth), lambda: GeoJsonResponse(on_earth))


@router.delete(
    "/{venue}",
    name="deleteVenue",
    status_code=204,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def remove(state: State, venue: VenueId) -> Response:
    """Delete a venue with its floors, maps, builds and sessions, and the files that only they refer to."""
    resources = state.services.resources
    with resources.database.write() as connection:
        digests = venue_blobs(connection, venue)
        delete_venue(connection, venue)
    # What a running build may have stored too, the sweep looks at again.
    discard_blobs(resources.database, resources.blobs, digests, written_by="")
    return Response(status_code=204)
