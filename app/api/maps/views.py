"""What pages draw of a map version: points, keyframes, coverage, and a picture from above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from app.api.deps import ID_PATTERN, State, VenueId, require
from app.api.maps.versions import Version
from app.api.requests.conditional import NOT_MODIFIED, is_known, unless_known
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import FILE_CONTENT, PoseBody, problems
from app.engine.maps.drawing.coverage import DIRECTIONS, Coverage
from app.limits import limit
from app.services.map_views.views import KeyframeView

router = APIRouter(
    prefix="/venues/{venue}/maps/{version}",
    tags=["maps"],
    route_class=ContractRoute,
    dependencies=[Depends(require("admin"))],
)
PLY = "application/ply"
BINARY = "application/octet-stream"
JSON = "application/json"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapViewRequestOptions:
    """What may be asked of a map to draw."""

    default_points: int = limit(
        50_000, "Points that are returned by default.", chosen="By hand: 750 kB, which a page draws at once."
    )
    max_points: int = limit(
        1_000_000, "Largest number of points that can be asked for.", chosen="By hand: 15 MB."
    )
    max_picture_px: int = limit(
        2048, "Largest width of a picture that is made.", chosen="By hand: a large screen."
    )
    default_cell_m: float = limit(
        1.0, "Edge of a cell of the coverage by default.", chosen="By hand: about the step of a person."
    )
    min_cell_m: float = limit(
        0.25, "Smallest edge of a cell.", chosen="By hand: below a keyframe's distance there is nothing new."
    )
    max_cell_m: float = limit(20.0, "Largest edge of a cell.", chosen="By hand: a large hall.")


OPTIONS = MapViewRequestOptions()
FloorQuery = Annotated[
    str,
    Query(pattern=ID_PATTERN, description="The floor's id; without it the whole map in the world's x and y"),
]
WidthQuery = Annotated[int, Query(ge=16, le=OPTIONS.max_picture_px, description="Pixels of the longer side")]


class PlanPlaceBody(BaseModel):
    """A place on a floor's plan."""

    x: float
    y: float
    heading_deg: float


class MapKeyframeBody(BaseModel):
    """A keyframe of a map; `pose` is world_from_camera."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "keyframe": 151,
                "name": "rgb/1216.800000.jpg",
                "time_s": 1216.8,
                "pose": {
                    "position": {"x": 13.912, "y": 15.635, "z": 1.67},
                    "quaternion": {"x": -0.3618, "y": -0.6083, "z": 0.6562, "w": 0.2617},
                },
                "floor": "0",
                "plan": {"x": 14.865, "y": 17.163, "heading_deg": 307.5},
                "features": 412,
                "picture": True,
            }
        }
    )

    keyframe: int
    name: str = Field(description="Its file in the scan")
    time_s: float | None = Field(description="Seconds, where its name states them")
    pose: PoseBody
    floor: str | None
    plan: PlanPlaceBody | None = Field(description="Metres; null where the map has no place on a plan")
    features: int
    picture: bool = Field(description="Whether .../keyframes/{keyframe}/picture has its picture")

    @staticmethod
    def of(view: KeyframeView) -> MapKeyframeBody:
        """Return the body of a keyframe."""
        plan = view.plan
        return MapKeyframeBody(
            keyframe=view.keyframe,
            name=view.name,
            time_s=view.time_s,
            pose=PoseBody.of(view.world_from_camera),
            floor=view.floor,
            plan=None
            if plan is None
            else PlanPlaceBody(
                x=round(plan.x, 4), y=round(plan.y, 4), heading_deg=round(plan.heading_deg, 2)
            ),
            features=view.features,
            picture=view.has_picture,
        )


class CoverageCell(BaseModel):
    """A cell of the floor, with one entry for each of `directions_deg`."""

    x: float = Field(description="Centre, plan metres")
    y: float
    features: list[int] = Field(
        description="Most features in view that one keyframe shares with a phone here"
    )
    covered: list[bool] = Field(description="Whether a phone here would be located")


class CoverageBody(BaseModel):
    """Where on a floor a phone would be located, by the direction in which it looks: a forecast from the keyframes
    around, not a measurement."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "floor": "0",
                "cell_m": 1.0,
                "directions_deg": [0.0, 180.0],
                "cells": [{"x": 2.5, "y": 3.5, "features": [210, 12], "covered": [True, False]}],
            }
        }
    )

    floor: str
    cell_m: float
    directions_deg: list[float] = Field(description="Counter-clockwise from plan x")
    cells: list[CoverageCell] = Field(description="Cells within reach of a keyframe")


@router.get(
    "/points",
    name="getMapPoints",
    responses={
        200: {"content": {BINARY: FILE_CONTENT, PLY: FILE_CONTENT}},
        **NOT_MODIFIED,
        **problems(401, 404, 422),
    },
    response_class=Response,
)
async def points(
    state: State,
    request: Request,
    venue: VenueId,
    version: Version,
    file_format: Annotated[
        Literal["binary", "ply"],
        Query(
            alias="format",
            description="ply, or binary: RFPTS001, the count n (uint32), n x 3 float32 metres, n x 3 uint8 RGB",
        ),
    ] = "binary",
    max_points: Annotated[
        int, Query(ge=1, le=OPTIONS.max_points, description="How many points at most")
    ] = OPTIONS.default_points,
) -> Response:
    """Return the map's points, thinned evenly, in world metres with their colours; grey where no pictures are kept."""
    views = state.services.map_views
    digest = f"{await run_in_threadpool(views.map_blob, venue, version)}-{max_points}-{file_format}"

    def draw() -> bytes:
        drawn = views.points(venue, version, max_points)
        return drawn.ply() if file_format == "ply" else drawn.packed()

    response = await state.drawings.answer(request, digest, draw, PLY if file_format == "ply" else BINARY)
    if file_format == "ply":
        response.headers["Content-Disposition"] = f'attachment; filename="{venue}-{version}.ply"'
    return response


@router.get(
    "/keyframes",
    name="listKeyframes",
    response_model=list[MapKeyframeBody],
    responses=problems(401, 404, 422),
)
async def keyframes(state: State, venue: VenueId, version: Version) -> Response:
    """List the map's keyframes in the order of the scan."""

    def draw() -> bytes:
        found = state.services.map_views.keyframes(venue, version)
        return TypeAdapter(list[MapKeyframeBody]).dump_json([MapKeyframeBody.of(view) for view in found])

    return Response(await state.drawings.run(draw), media_type=JSON)


@router.get(
    "/keyframes/{keyframe}/picture",
    name="getKeyframePicture",
    responses={200: {"content": {"image/jpeg": FILE_CONTENT}}, **NOT_MODIFIED, **problems(401, 404, 422)},
    response_class=Response,
)
async def picture(
    state: State,
    request: Request,
    venue: VenueId,
    version: Version,
    keyframe: Annotated[int, Path(ge=0, le=2**31 - 1, description="The keyframe's number")],
    width: Annotated[
        int | None,
        Query(ge=16, le=OPTIONS.max_picture_px, description="Pixels; without it as the scan has it"),
    ] = None,
) -> Response:
    """Return the picture of a keyframe, of a map that was built with store_images."""
    views = state.services.map_views
    blob = await run_in_threadpool(views.picture_blob, venue, version, keyframe)
    digest = blob if width is None else f"{blob}-{width}"
    if is_known(request, digest):
        return unless_known(request, digest, Response)
    data = await state.drawings.run(lambda: views.picture(blob, width))
    return unless_known(request, digest, lambda: Response(data, media_type="image/jpeg"))


@router.get(
    "/coverage",
    name="getCoverage",
    response_model=CoverageBody,
    responses=problems(401, 404, 409, 422),
)
async def coverage(
    state: State,
    venue: VenueId,
    version: Version,
    floor: Annotated[str, Query(pattern=ID_PATTERN, description="The floor's id")],
    cell_m: Annotated[
        float,
        Query(ge=OPTIONS.min_cell_m, le=OPTIONS.max_cell_m, description="Edge of a cell, metres"),
    ] = OPTIONS.default_cell_m,
) -> Response:
    """Return where on a floor a phone would be located."""

    def draw() -> bytes:
        found = state.services.map_views.coverage(venue, version, floor, cell_m)
        return _coverage_body(found, floor, cell_m).model_dump_json().encode()

    return Response(await state.drawings.run(draw), media_type=JSON)


def _coverage_body(found: Coverage, floor: str, cell_m: float) -> CoverageBody:
    rows = zip(found.centres.round(3), found.features, found.is_covered, strict=True)
    cells = [
        CoverageCell(x=x, y=y, features=features.tolist(), covered=covered.tolist())
        for (x, y), features, covered in rows
    ]
    directions = [k * 360.0 / DIRECTIONS for k in range(DIRECTIONS)]
    return CoverageBody(floor=floor, cell_m=cell_m, directions_deg=directions, cells=cells)


@router.get(
    "/map.png",
    name="drawMap",
    responses={200: {"content": {"image/png": FILE_CONTENT}}, **problems(401, 404, 409, 422)},
    response_class=Response,
)
async def top_view(
    state: State, venue: VenueId, version: Version, floor: FloorQuery | None = None, width: WidthQuery = 1024
) -> Response:
    """Return the map from above: points in their colours, keyframes as dots, over the floor's plan image."""
    views = state.services.map_views
    data = await state.drawings.run(lambda: views.top_view(venue, version, floor, width))
    return Response(data, media_type="image/png")
