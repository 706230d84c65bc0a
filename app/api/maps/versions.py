"""Map versions: which there are, which one serves, and deleting one."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Response
from pydantic import BaseModel, ConfigDict

from app.api.bodies.report import BuildReport
from app.api.deps import State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.requests.paging import Paged
from app.api.schemas import problems
from app.storage.maps import MapVersion, delete_map, get_map, list_maps
from app.storage.venues import get_venue, set_active_map

router = APIRouter(prefix="/venues/{venue}/maps", tags=["maps"], route_class=ContractRoute)
Version = Annotated[int, Path(ge=1, le=2**31 - 1, description="The map version's number")]


class MapVersionBody(BaseModel):
    """A map version with the statistics of its build."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "version": 3,
                "active": True,
                "build": "0d8f5b5c2f0a4f1e9a6c1b2d3e4f5a6b",
                "created_at": "2026-03-01T09:05:00Z",
                "statistics": {"keyframes": 480, "features": 196000, "warnings": []},
            }
        }
    )

    version: int
    active: bool
    build: str | None
    created_at: datetime
    statistics: BuildReport


def _body(version: MapVersion, active: int | None) -> MapVersionBody:
    return MapVersionBody(
        version=version.version,
        active=version.version == active,
        build=version.build_id,
        created_at=version.created_at,
        statistics=version.statistics,
    )


@router.get(
    "",
    name="listMaps",
    response_model_exclude_unset=True,
    dependencies=[Depends(require("locate"))],
    responses=problems(401, 404, 422),
)
def list_all(state: State, page: Paged, venue: VenueId) -> list[MapVersionBody]:
    """List a venue's map versions, newest first."""
    with state.services.resources.database.read() as connection:
        active = get_venue(connection, venue).active_map_version
        found = list_maps(connection, venue)
    return [_body(version, active) for version in page.of(found, lambda version: version.version)]


@router.post(
    "/{version}/activate",
    name="activateMap",
    response_model_exclude_unset=True,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def activate(state: State, venue: VenueId, version: Version) -> MapVersionBody:
    """Let a map version serve the venue: roll back, or forward again."""
    with state.services.resources.database.write() as connection:
        get_venue(connection, venue)
        found = get_map(connection, venue, version)
        set_active_map(connection, venue, version)
    return _body(found, version)


@router.delete(
    "/{version}",
    name="deleteMap",
    status_code=204,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 409, 422),
)
def remove(state: State, venue: VenueId, version: Version) -> Response:
    """Delete a map version with its keyframes' pictures; the one that serves can't be deleted."""
    with state.services.resources.database.write() as connection:
        delete_map(connection, venue, version)
    return Response(status_code=204)
