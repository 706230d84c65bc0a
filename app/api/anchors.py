"""Anchors: monitoring cameras that push frames."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.datastructures import UploadFile

from app.api.bodies.anchor import Anchor
from app.api.deps import ID_PATTERN, CallerOf, State, require
from app.api.requests.contract_route import ContractRoute
from app.api.requests.described import CAMERA_TYPES, DescribedAs
from app.api.requests.fields import FIELDS
from app.api.requests.form_request import is_multipart
from app.api.requests.json_body import RequestBody
from app.api.requests.paging import Paged
from app.api.schemas import FILE_CONTENT, problems
from app.engine.anchors.anchor import AnchorSpec, Poi
from app.errors import InvalidInputError
from app.geometry.camera_hint import parse_camera_hint
from app.services.anchors import anchor_as_dict
from app.storage.anchors import delete_anchor, get_anchor, list_anchors, list_frames
from app.vision.image_files.formats import FORMATS_IN_WORDS

router = APIRouter(prefix="/anchors", tags=["anchors"], route_class=ContractRoute)
AnchorId = Annotated[str, Path(pattern=ID_PATTERN, description="The monitoring camera's id")]
IMAGE_BODY: dict[str, Any] = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["image"],
                "properties": {"image": FILE_CONTENT["schema"]},
                "additionalProperties": False,
            }
        },
        "image/jpeg": FILE_CONTENT,
        "image/png": FILE_CONTENT,
        "image/webp": FILE_CONTENT,
    },
}
Number = Annotated[float, Field(allow_inf_nan=False)]


class PlanPosition(RequestBody):
    """A point on the plan, in metres."""

    x: Number
    y: Number


class PoiBody(RequestBody):
    """A point of interest: where it is in the camera's picture, on the plan, and how far from the camera."""

    id: str = Field(pattern=ID_PATTERN)
    region_px: list[Annotated[list[Number], Field(min_length=2, max_length=2)]] = Field(
        min_length=3,
        max_length=FIELDS.max_region_corners,
        description="Corners [u, v] around it, in pixels of the camera's frames",
    )
    position: PlanPosition = Field(description="Where the middle of the region is on the plan")
    distance_m: Number = Field(description="From the camera straight to the middle of the region")
    height_m: Number | None = Field(None, description="Height on the plan's z axis, where known")


class NewAnchor(RequestBody):
    """A monitoring camera and its POIs."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "venue": "museum",
                "floor": "0",
                "position": {"x": 4.2, "y": 11.0},
                "height_m": 2.6,
                "camera": {"model": "PINHOLE", "width": 1280, "height": 720, "params": [910, 910, 640, 360]},
                "pois": [
                    {
                        "id": "exit-sign",
                        "region_px": [[560, 210], [720, 210], [720, 300], [560, 300]],
                        "position": {"x": 9.8, "y": 12.5},
                        "distance_m": 5.9,
                    }
                ],
            }
        }
    )

    venue: str = Field(pattern=ID_PATTERN)
    floor: str = Field(pattern=ID_PATTERN)
    position: PlanPosition
    height_m: Number = Field(description="The camera's height on the plan's z axis")
    heading_deg: Number | None = Field(
        None, description="Where it looks, counter-clockwise from plan x; a check only"
    )
    camera: Annotated[Any, DescribedAs(CAMERA_TYPES)] = Field(
        description='"fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]", or {model, width, height, params}'
    )
    pois: list[PoiBody] = Field(min_length=1, max_length=FIELDS.max_pois)
    store_images: bool = Field(False, description="Keep the newest frame's image too, not its features alone")
    max_age_s: Number | None = Field(None, gt=0, description="Age from which its frame is not used any more")


class PushedFrame(BaseModel):
    """What became of a frame."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "frame": "7c9e6679f2b14c0c8a5d54a1f0f3c2b7",
                "features": 812,
                "pois_visible": ["exit-sign"],
                "received_at": "2026-03-01T09:00:00Z",
            }
        }
    )

    frame: str
    features: int
    pois_visible: list[str]
    received_at: datetime


@router.get(
    "",
    name="listAnchors",
    response_model=list[Anchor],
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 422),
)
def list_all(
    state: State,
    caller: CallerOf,
    page: Paged,
    venue: Annotated[str | None, Query(description="Of this venue only")] = None,
) -> Any:
    """List anchors by their id."""
    with state.services.resources.database.read() as connection:
        found = page.of(list_anchors(connection, caller.venue_or_own(venue)), lambda anchor: anchor.id)
        frames = list_frames(connection, [anchor.id for anchor in found])
    settings = state.services.resources.settings
    return [anchor_as_dict(anchor, frames.get(anchor.id), settings.anchor_max_age_s) for anchor in found]


@router.put(
    "/{camera}",
    name="putAnchor",
    response_model=Anchor,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 409, 422),
)
def put(state: State, caller: CallerOf, camera: AnchorId, body: NewAnchor) -> Any:
    """Add or replace a monitoring camera; one that looks elsewhere now loses its frame and its calibration."""
    caller.check_venue(body.venue)
    state.services.anchors.put(camera, _spec(body))
    return get(state, camera)


@router.get(
    "/{camera}",
    name="getAnchor",
    response_model=Anchor,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def get(state: State, camera: AnchorId) -> Any:
    """Return an anchor, its newest frame's age and features, and how often it has located a phone."""
    with state.services.resources.database.read() as connection:
        anchor = get_anchor(connection, camera)
        frame = list_frames(connection, [camera]).get(camera)
    return anchor_as_dict(anchor, frame, state.services.resources.settings.anchor_max_age_s)


@router.delete(
    "/{camera}",
    name="deleteAnchor",
    status_code=204,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 422),
)
def remove(state: State, camera: AnchorId) -> Response:
    """Delete an anchor with its frame."""
    with state.services.resources.database.write() as connection:
        delete_anchor(connection, camera)
    return Response(status_code=204)


@router.get(
    "/{camera}/picture",
    name="getAnchorPicture",
    dependencies=[Depends(require("admin"))],
    responses={200: {"content": {"image/jpeg": FILE_CONTENT}}, **problems(401, 404, 422)},
    response_class=Response,
)
def picture(state: State, camera: AnchorId) -> Response:
    """Return an anchor's newest frame, where the anchor says that its image is kept."""
    return Response(state.services.anchors.picture(camera), media_type="image/jpeg")


@router.post(
    "/{camera}/frames",
    name="pushAnchorFrame",
    dependencies=[Depends(require("anchor"))],
    responses=problems(401, 404, 409, 413, 415, 422, 503),
    openapi_extra={"requestBody": IMAGE_BODY},
)
async def push(state: State, camera: AnchorId, request: Request) -> PushedFrame:
    """Push a camera's newest frame, as a form field or as the body itself. Its features are kept, it is not,
    unless the anchor says so."""
    image = await image_of(request)
    pushed = await state.executor.run(lambda: state.services.anchors.push(camera, image))
    return PushedFrame(
        frame=pushed.frame,
        features=pushed.features,
        pois_visible=list(pushed.pois_visible),
        received_at=pushed.received_at,
    )


@router.post(
    "/{camera}/calibrate",
    name="calibrateAnchor",
    response_model=Anchor,
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 409, 413, 415, 422, 503),
    openapi_extra={"requestBody": {**IMAGE_BODY, "required": False}},
)
async def calibrate(state: State, camera: AnchorId, request: Request) -> Any:
    """Find the camera and its POIs in the venue's map, by the picture sent or else the newest stored one. From then on
    the camera's frames get their distances from the map."""
    image = await image_of(request)
    await state.executor.run(lambda: state.services.anchors.calibrate(camera, image or None))
    return await asyncio.to_thread(get, state, camera)


async def image_of(request: Request) -> bytes:
    """Return the bytes of an image that is a form field `image` or the whole body."""
    if not is_multipart(request.headers):
        return await request.body()
    async with request.form() as form:
        image = form.get("image")
        if not isinstance(image, UploadFile):
            raise InvalidInputError(f"The form needs a file field image with a picture: {FORMATS_IN_WORDS}.")
        return await image.read()


def _spec(body: NewAnchor) -> AnchorSpec:
    camera = parse_camera_hint(body.camera)
    if camera is None:
        raise InvalidInputError(
            "camera must be fx,fy,cx,cy[,k1,k2,p1,p2[,k3]] or {model, width, height, params}."
        )
    return AnchorSpec(
        venue_id=body.venue,
        floor_id=body.floor,
        x=body.position.x,
        y=body.position.y,
        height_m=body.height_m,
        heading_deg=body.heading_deg,
        camera=camera,
        pois=tuple(_poi(poi) for poi in body.pois),
        store_images=body.store_images,
        max_age_s=body.max_age_s,
    )


def _poi(body: PoiBody) -> Poi:
    region = tuple((u, v) for u, v in body.region_px)
    return Poi(
        id=body.id,
        region_px=region,
        x=body.position.x,
        y=body.position.y,
        distance_m=body.distance_m,
        height_m=body.height_m,
    )
