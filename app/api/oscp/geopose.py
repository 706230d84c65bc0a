"""`POST /oscp/geopose`: the GeoPose protocol of the Open Spatial Computing Platform, versions 1 and 2."""

from __future__ import annotations

import base64
import binascii
import re
import time
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import JSONResponse

from app.api.bodies.earth import GeoPoseBody
from app.api.deps import ID_PATTERN, AppState, CallerOf, State, require
from app.api.oscp.request import CameraParameters, GeoPoseRequest, Picture
from app.api.oscp.response import BasicQuaternion, GeoPoseAccuracy, GeoPoseResponse
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.engine.floors.earth import GeoPoseReason
from app.errors import ConflictError, InvalidInputError, NotLocatedError
from app.geometry.camera_hint import CameraHint, parse_camera_hint
from app.services.locate_result import LocateRequest, LocateResult
from app.services.oscp.find_venue import RoughPosition, find_venue
from app.vision.image_files.raw_pixels import png_of_pixels

MEDIA_TYPE = "application/vnd.oscp+json"
VERSIONS = (1, 2)
VERSION = re.compile(rf"{re.escape(MEDIA_TYPE)}\s*;\s*version\s*=\s*\"?(\d{{1,9}})", re.IGNORECASE)
# First bytes of picture files that clients send as if they were pixels.
FILE_STARTS = (b"\xff\xd8\xff", b"\x89PNG", b"RIFF")
PIXELS = ("RGBA32", "GRAY8")
UNKNOWN_CAMERAS = ("UNKNOWN", "UNKNOWN_CAMERA")
# Models whose parameters mean the same in an image of any size as numbers without a model do.
WITHOUT_SIZE = ("PINHOLE", "OPENCV")
NO_GEOPOSE: dict[GeoPoseReason | None, str] = {
    "no_origin": "the venue has no place on Earth: an administrator sets its origin",
    "up_unknown": "the map's z axis is not known to point up: build it with gravity",
    "scale_unknown": "the map's unit is not known to be the metre: build it with a scale",
    "plan_unknown": "it is not known how the plan of the origin's floor lies in the world: set its plan_from_world",
}


class PictureJsonRoute(ContractRoute):
    """A route whose JSON holds a picture."""

    body_kind = "image"


router = APIRouter(
    prefix="/oscp",
    tags=["locate"],
    dependencies=[Depends(require("locate"))],
    route_class=PictureJsonRoute,
)


@router.post(
    "/geopose",
    name="locateOscp",
    response_model=GeoPoseResponse,
    responses={
        200: {
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/GeoPoseResponse"}}},
        },
        **problems(401, 404, 409, 413, 415, 422, 503),
    },
)
async def locate(
    state: State,
    caller: CallerOf,
    http: Request,
    request: GeoPoseRequest,
    venue: Annotated[
        str | None,
        Query(
            pattern=ID_PATTERN, description="Without it the key's own, else the one nearest to the position"
        ),
    ] = None,
) -> Any:
    """Locate one picture by the GeoPose protocol of the Open Spatial Computing Platform, version 1 or 2.

    The answer is the geopose of `/locate`. A picture that can't be placed is a 404 `not_located`; no venue near the
    position a 404 `no_venue`, two of them a 409 `ambiguous_venue`.
    """
    accepted = http.headers.get("accept", "")
    _check_versions(accepted)
    own = caller.venue_or_own(venue)
    result = await state.executor.run(lambda: _located(state, request, own))
    state.metrics.observe_query(result)
    media_type = "application/json"
    if MEDIA_TYPE in accepted.lower():
        media_type = f"{MEDIA_TYPE}; version={request.version}.0"
    return JSONResponse(_response(request, result).model_dump(), media_type=media_type)


def _located(state: AppState, request: GeoPoseRequest, venue: str | None) -> LocateResult:
    """Return the answer of /locate to the request's picture; raises `RoomfixError`."""
    found = request.picture()
    if found is None:
        raise InvalidInputError("The request needs a camera reading with imageBytes.")
    picture, params = found
    if venue is None:
        at = request.geolocation()
        rough = None if at is None else RoughPosition(at.longitude, at.latitude, at.accuracy)
        venue = find_venue(state.services.resources, rough)
    return state.services.locate.locate(
        LocateRequest(image=_image(picture), venue=venue, camera=_camera(picture, params))
    )


def _response(request: GeoPoseRequest, result: LocateResult) -> GeoPoseResponse:
    """Return the protocol's answer; raises `NotLocatedError`, and `ConflictError` for a pose that has no place on
    Earth."""
    if result.reason is not None:
        raise NotLocatedError(f"The picture could not be located: {result.reason}.")
    if result.geopose is None:
        raise ConflictError(
            f"The picture is located, and {NO_GEOPOSE.get(result.geopose_reason, 'has no GeoPose')}."
        )
    body, accuracy = GeoPoseBody.of(result.geopose), result.accuracy
    return GeoPoseResponse(
        id=request.id,
        timestamp=round(time.time() * 1000),
        accuracy=None
        if accuracy is None
        else GeoPoseAccuracy(
            position=round(accuracy.position_m, 5), orientation=round(accuracy.orientation_deg, 4)
        ),
        geopose=BasicQuaternion(position=body.position, quaternion=body.quaternion),
    )


def _check_versions(accepted: str) -> None:
    """Raise `InvalidInputError` where a client accepts other versions of the protocol alone."""
    wanted = {int(version) for version in VERSION.findall(accepted)}
    if wanted and not wanted & set(VERSIONS):
        raise InvalidInputError("Versions 1.0 and 2.0 of the GeoPose protocol are answered.")


def _image(picture: Picture) -> bytes:
    """Return the picture as a file; raises `InvalidInputError`."""
    if picture.imageOrientation is not None and picture.imageOrientation.mirrored:
        raise InvalidInputError("Send the picture as the camera saw it: a mirrored one can't be located.")
    try:
        data = base64.b64decode("".join(picture.imageBytes.split()), validate=True)
    except (binascii.Error, ValueError):
        raise InvalidInputError(
            "imageBytes must be base64 alone, without a prefix such as data:image/jpeg;base64, before it."
        ) from None
    kind = picture.imageFormat.upper()
    if kind == "DEPTH":
        raise InvalidInputError("A depth image alone can't be located: send a picture.")
    if kind not in PIXELS or data.startswith(FILE_STARTS):
        return data
    if _size(picture) is None:
        raise InvalidInputError(f"size is needed, [width, height], for pixels of the format {kind}.")
    width, height = _size(picture) or (0, 0)
    return png_of_pixels(data, width, height)


def _size(picture: Picture) -> tuple[int, int] | None:
    size = picture.size or []
    return (size[0], size[1]) if len(size) == 2 and min(size) > 0 else None


def _camera(picture: Picture, params: CameraParameters | None) -> CameraHint | None:
    """Return what is known of the camera; raises `InvalidCameraError` and `InvalidInputError`."""
    if params is None or not params.modelParams or (params.model or "PINHOLE") in UNKNOWN_CAMERAS:
        return None
    size = _size(picture)
    if size is not None:
        stated = {"model": params.model or "PINHOLE", "width": size[0], "height": size[1]}
        return parse_camera_hint({**stated, "params": params.modelParams}, "params")
    if params.model not in (None, *WITHOUT_SIZE):
        raise InvalidInputError(f"size is needed, [width, height], for a camera of the model {params.model}.")
    return parse_camera_hint(list(params.modelParams), "modelParams")
