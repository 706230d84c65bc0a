"""Floors and their plan images."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, File, Form, Path, Request, Response, UploadFile
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from app.api.bodies.floor import Floor, StoredFloor
from app.api.deps import FloorId, State, VenueId, require
from app.api.requests.conditional import NOT_MODIFIED, unless_known
from app.api.requests.contract_route import ContractRoute
from app.api.requests.described import PLAN_FROM_WORLD_TYPES, DescribedAs
from app.api.requests.fields import FIELDS, NAME_PATTERN
from app.api.requests.json_body import RequestBody, whole
from app.api.schemas import FILE_CONTENT, problems
from app.engine.floors.plan_alignment import parse_plan_from_world
from app.errors import InvalidInputError, NotFoundError
from app.services.floor_plans import (
    PLAN_FORMATS_IN_WORDS,
    PlanFile,
    as_dict,
    plan_picture,
    plan_tile,
    store_plan_image,
)
from app.storage.floors import delete_floor, get_floor, list_floors, put_floor
from app.storage.venues import get_venue

router = APIRouter(prefix="/venues/{venue}/floors", tags=["floors"], route_class=ContractRoute)
PICTURES: dict[str, Any] = {"content": {"image/png": FILE_CONTENT, "image/jpeg": FILE_CONTENT}}

# Far more than a plan has; larger numbers are no numbers of tiles.
MAX_TILE = 1_000_000

Units = Literal["mm", "cm", "m", "in", "ft"]
ORIGIN_HELP = (
    "u,v of plan (0, 0) in the picture, e.g. 100,820; default: its lower left pixel, of a DXF its own (0, 0)"
)
DPI_HELP = "Dots an inch that a PDF or SVG is drawn with (150 if not given), or a picture was scanned with"


class NewFloor(RequestBody):
    """A floor. `plan_from_world` is a 4x4 matrix, or pairs of points to fit it to."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "name": "Ground floor",
                "level": 0,
                "z_min_m": -0.5,
                "z_max_m": 3.0,
                "plan_from_world": {
                    "correspondences": [
                        {"world": [0.0, 0.0, 0.0], "plan": [2.0, 1.5]},
                        {"world": [10.0, 0.0, 0.0], "plan": [12.0, 1.5]},
                    ]
                },
            }
        }
    )

    name: str = Field(min_length=1, max_length=FIELDS.max_name_characters, pattern=NAME_PATTERN)
    level: Annotated[int, BeforeValidator(whole)] = Field(ge=FIELDS.min_level, le=FIELDS.max_level)
    z_min_m: float = Field(allow_inf_nan=False)
    z_max_m: float = Field(allow_inf_nan=False)
    plan_from_world: Annotated[Any, DescribedAs(PLAN_FROM_WORLD_TYPES | None)] = None

    @model_validator(mode="after")
    def _heights(self) -> NewFloor:
        if self.z_min_m >= self.z_max_m:
            raise ValueError("z_min_m must be below z_max_m")
        return self


@router.get(
    "",
    name="listFloors",
    response_model=list[Floor],
    dependencies=[Depends(require("locate"))],
    responses=problems(401, 404, 422),
)
def list_all(state: State, venue: VenueId) -> Any:
    """List a venue's floors, lowest first."""
    with state.services.resources.database.read() as connection:
        get_venue(connection, venue)
        return [as_dict(floor) for floor in list_floors(connection, venue)]


@router.put(
    "/{floor}",
    name="putFloor",
    response_model=StoredFloor,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def put(state: State, venue: VenueId, floor: FloorId, body: NewFloor) -> Any:
    """Add or change a floor; says how well fitted correspondences agree."""
    alignment = parse_plan_from_world(body.plan_from_world, body.z_max_m - body.z_min_m)
    with state.services.resources.database.write() as connection:
        get_venue(connection, venue)
        stored = put_floor(
            connection,
            venue,
            floor,
            name=body.name,
            level=body.level,
            z_min_m=body.z_min_m,
            z_max_m=body.z_max_m,
            plan_from_world=None if alignment is None else alignment.matrix,
            plan_residual_m=None if alignment is None else alignment.residual_m,
        )
    return {**as_dict(stored), "plan_scale": None if alignment is None else alignment.scale}


@router.get(
    "/{floor}",
    name="getFloor",
    response_model=Floor,
    dependencies=[Depends(require("locate"))],
    responses=problems(401, 404, 422),
)
def get(state: State, venue: VenueId, floor: FloorId) -> Any:
    """Return a floor."""
    with state.services.resources.database.read() as connection:
        return as_dict(get_floor(connection, venue, floor))


@router.delete(
    "/{floor}",
    name="deleteFloor",
    status_code=204,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def remove(state: State, venue: VenueId, floor: FloorId) -> Response:
    """Delete a floor with its plan."""
    with state.services.resources.database.write() as connection:
        delete_floor(connection, venue, floor)
    return Response(status_code=204)


@router.put(
    "/{floor}/plan",
    name="putPlan",
    response_model=Floor,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 413, 415, 422),
)
def put_plan(
    state: State,
    venue: VenueId,
    floor: FloorId,
    image: Annotated[UploadFile, File(description=PLAN_FORMATS_IN_WORDS)],
    meters_per_pixel: Annotated[float | None, Form(description="Metres that one pixel shows")] = None,
    origin_px: Annotated[str | None, Form(description=ORIGIN_HELP)] = None,
    page: Annotated[int, Form(description="Page of a PDF or TIFF, from 1", ge=1, le=10_000)] = 1,
    dpi: Annotated[float | None, Form(description=DPI_HELP, ge=10, le=1200)] = None,
    scale: Annotated[
        str | None, Form(description="Of the drawing on paper, such as 1:100", max_length=20)
    ] = None,
    units: Annotated[Units | None, Form(description="Of a DXF that states none")] = None,
) -> Any:
    """Store a floor's plan: a picture as it is, a drawing as the picture that is drawn from it."""
    with state.services.resources.database.read() as connection:
        get_floor(connection, venue, floor)
    file = PlanFile(
        data=image.file.read(),
        meters_per_pixel=meters_per_pixel,
        origin_px=None if origin_px is None else _pixel(origin_px),
        page=page,
        dpi=dpi,
        scale=scale,
        units=units,
    )
    stored = store_plan_image(state.services.resources, venue, floor, file)
    return as_dict(stored)


@router.post(
    "/{floor}/plan/picture",
    name="drawPlanFile",
    dependencies=[Depends(require("admin"))],
    responses={200: PICTURES, **problems(401, 404, 413, 415, 422)},
    response_class=Response,
)
def draw_plan_file(
    state: State,
    venue: VenueId,
    floor: FloorId,
    image: Annotated[UploadFile, File(description=PLAN_FORMATS_IN_WORDS)],
    page: Annotated[int, Form(description="Page of a PDF or TIFF, from 1", ge=1, le=10_000)] = 1,
    dpi: Annotated[float | None, Form(description=DPI_HELP, ge=10, le=1200)] = None,
) -> Response:
    """Return the picture that a plan's file would be stored as, to find its scale in; stores nothing."""
    with state.services.resources.database.read() as connection:
        get_floor(connection, venue, floor)
    file = PlanFile(data=image.file.read(), page=page, dpi=dpi)
    data, media_type = plan_picture(state.services.resources, file)
    return Response(data, media_type=media_type)


@router.get(
    "/{floor}/plan",
    name="getPlan",
    dependencies=[Depends(require("locate"))],
    responses={
        200: PICTURES,
        **NOT_MODIFIED,
        **problems(401, 404, 422),
    },
    response_class=Response,
)
def get_plan(state: State, venue: VenueId, floor: FloorId, request: Request) -> Response:
    """Return a floor's plan image."""
    with state.services.resources.database.read() as connection:
        plan = get_floor(connection, venue, floor).plan
    if plan is None:
        raise NotFoundError(f"Floor {floor!r} has no plan image.")
    blobs = state.services.resources.blobs
    return unless_known(
        request, plan.blob, lambda: Response(blobs.get(plan.blob), media_type=plan.media_type)
    )


@router.get(
    "/{floor}/plan/tiles/{zoom}/{column}/{row}.png",
    name="getPlanTile",
    dependencies=[Depends(require("locate"))],
    responses={200: {"content": {"image/png": FILE_CONTENT}}, **NOT_MODIFIED, **problems(401, 404, 422)},
    response_class=Response,
)
def get_plan_tile(
    state: State,
    venue: VenueId,
    floor: FloorId,
    zoom: Annotated[int, Path(ge=0, le=MAX_TILE, description="0 for the whole plan in one tile")],
    column: Annotated[int, Path(ge=0, le=MAX_TILE, description="From the left")],
    row: Annotated[int, Path(ge=0, le=MAX_TILE, description="From above")],
    request: Request,
) -> Response:
    """Return a tile of a plan of many pixels, whose floor says how it is cut."""
    tile = plan_tile(state.services.resources, venue, floor, zoom, column, row)
    return unless_known(request, tile.digest, lambda: Response(tile.read(), media_type="image/png"))


def _pixel(text: str) -> tuple[float, float]:
    try:
        values = json.loads(text) if text.strip().startswith("[") else text.split(",")
        u, v = (float(value) for value in values)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError("origin_px must be two numbers, u,v.") from None
    return u, v
