"""Venues."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import ID_PATTERN, CallerOf, State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.requests.fields import FIELDS
from app.api.requests.json_body import RequestBody
from app.api.requests.paging import Paged
from app.api.schemas import problems
from app.storage.sweep import discard_blobs, venue_blobs
from app.storage.venues import Venue, create_venue, delete_venue, get_venue, list_venues, rename_venue

router = APIRouter(prefix="/venues", tags=["venues"], route_class=ContractRoute)
Name = Annotated[str, Field(min_length=1, max_length=FIELDS.max_name_characters)]


class NewVenue(RequestBody):
    """A venue to add."""

    model_config = ConfigDict(json_schema_extra={"example": {"id": "museum", "name": "City museum"}})

    id: str = Field(pattern=ID_PATTERN)
    name: Name


class VenueChange(RequestBody):
    """What can be changed of a venue."""

    model_config = ConfigDict(json_schema_extra={"example": {"name": "City museum, new wing"}})

    name: Name


class VenueBody(BaseModel):
    """A venue; `map_version` is the map that serves it, null before the first build."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": "museum",
                "name": "City museum",
                "created_at": "2026-03-01T09:00:00Z",
                "map_version": 3,
            }
        }
    )

    id: str
    name: str
    created_at: datetime
    map_version: int | None


def _body(venue: Venue) -> VenueBody:
    return VenueBody(
        id=venue.id, name=venue.name, created_at=venue.created_at, map_version=venue.active_map_version
    )


@router.post(
    "",
    name="createVenue",
    status_code=201,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 409, 422),
)
def create(state: State, caller: CallerOf, venue: NewVenue) -> VenueBody:
    """Add a venue."""
    caller.check_venue(None)
    with state.services.resources.database.write() as connection:
        return _body(create_venue(connection, venue.id, venue.name))


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
    """Change a venue's name."""
    with state.services.resources.database.write() as connection:
        return _body(rename_venue(connection, venue, change.name))


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
