"""One venue as a file: exported as a stream, imported as another server's."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Depends, File, Query, Request, UploadFile
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from app.api.access.log_acts import VENUE
from app.api.bodies.report import BuildReport
from app.api.deps import ID_PATTERN, CallerOf, State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import FILE_CONTENT, problems
from app.services.venue_files.export_venue import export_venue
from app.services.venue_files.import_venue import import_venue

router = APIRouter(prefix="/venues", tags=["venues"], route_class=ContractRoute)
MEDIA_TYPE = "application/x-tar"
FILE_HELP = "A file that GET /venues/{venue}/export or `roomfix export-venue` wrote"


class ImportedVenueBody(BaseModel):
    """A venue that was imported; `cameras` has the new id of each of its monitoring cameras."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": "museum-copy",
                "name": "City museum",
                "map_version": 3,
                "floors": 2,
                "maps": 1,
                "cameras": {"hall-camera": "museum-copy-hall-camera"},
            }
        }
    )

    id: str
    name: str
    map_version: int | None = Field(description="The map that serves it")
    floors: int
    maps: int = Field(description="Number of its map versions")
    cameras: dict[str, str]


@router.get(
    "/{venue}/export",
    name="exportVenue",
    dependencies=[Depends(require("admin"))],
    responses={200: {"content": {MEDIA_TYPE: FILE_CONTENT}}, **problems(401, 404, 422)},
    response_class=StreamingResponse,
)
def export(
    state: State,
    venue: VenueId,
    request: Request,
    maps: Annotated[
        Literal["all", "active"], Query(description="All versions, or the one that serves")
    ] = "all",
) -> StreamingResponse:
    """Return a venue as one file: floors, plans, features, monitoring cameras and maps; no keys and no sessions."""
    file = export_venue(state.services.resources, venue, active_only=maps == "active")
    # A copy of everything belongs in the audit log, although nothing is changed.
    request.scope[VENUE] = venue
    headers = {
        "Content-Length": str(file.size),
        "Content-Disposition": f'attachment; filename="{venue}.roomfix"',
    }
    return StreamingResponse(file.chunks, media_type=MEDIA_TYPE, headers=headers)


@router.post(
    "/import",
    name="importVenue",
    status_code=201,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 409, 413, 422),
)
def import_(
    state: State,
    caller: CallerOf,
    request: Request,
    archive: Annotated[UploadFile, File(description=FILE_HELP)],
    as_: Annotated[
        str | None,
        Query(alias="as", pattern=ID_PATTERN, description="Id of the venue, in place of the one in the file"),
    ] = None,
) -> ImportedVenueBody:
    """Add a venue from a file, verified whole before anything of it can be seen."""
    caller.check_venue(None)
    found = import_venue(state.services.resources, archive.file, BuildReport.model_validate, as_)
    request.scope[VENUE] = found.venue.id
    return ImportedVenueBody(
        id=found.venue.id,
        name=found.venue.name,
        map_version=found.venue.active_map_version,
        floors=found.floors,
        maps=found.maps,
        cameras=found.cameras,
    )
