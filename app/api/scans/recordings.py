"""Recordings: a scan that a phone films in the browser, sent frame by frame and built when it ends."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from app.api.access.log_acts import VENUE
from app.api.anchors import image_of
from app.api.deps import ID_PATTERN, CallerOf, State, require
from app.api.locate import _gravity
from app.api.requests.build_options import ScaleOption
from app.api.requests.contract_route import ContractRoute
from app.api.requests.json_body import RequestBody
from app.api.schemas import FILE_CONTENT, problems
from app.errors import InvalidInputError
from app.services.recordings.service import OPTIONS, RecordingState
from app.storage.builds import Build

router = APIRouter(
    prefix="/recordings",
    tags=["maps"],
    dependencies=[Depends(require("record"))],
    route_class=ContractRoute,
)
RecordingId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$", description="The recording's id")]
Number = Annotated[int, Path(ge=0, le=1_000_000, description="Counts the frames from 0, without a gap")]
PICTURE: dict[str, Any] = {"required": True, "content": {"image/jpeg": FILE_CONTENT}}
EXAMPLE: dict[str, Any] = {
    "recording": "9f8e1f0c6d5b4a3e8c7d6e5f4a3b2c1d",
    "venue": "museum",
    "frames": 180,
    "bytes": 21_500_000,
    "missing": [],
    "build": None,
    "created_at": "2026-03-01T09:00:00Z",
}


class NewRecording(RequestBody):
    """A recording to begin."""

    model_config = ConfigDict(json_schema_extra={"example": {"venue": "museum"}})

    venue: str | None = Field(
        None, pattern=ID_PATTERN, description="May be left out with a key that is limited to one venue"
    )


class RecordedCamera(BaseModel):
    """The phone's camera, as the reconstruction of its pictures found it."""

    model: str
    params: list[float]
    source: str


class RecordingBuild(BaseModel):
    """What becomes of the recording."""

    build: str
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    stage: str | None
    done: int
    total: int
    error: str | None
    error_code: str | None
    map_version: int | None
    keyframes: int | None = Field(description="Of the recording, in the map")
    connected: int | None = Field(description="Frames that could be connected with each other")
    chosen: int | None = Field(description="Frames that were used")
    left_out: dict[str, int] = Field(description="Number of frames that are not in the map, by reason")
    has_scale: bool | None
    camera: RecordedCamera | None
    warnings: list[str]

    @staticmethod
    def of(build: Build) -> RecordingBuild:
        """Return the body of a build."""
        report = build.report or {}
        structure = report.get("structure", {})
        return RecordingBuild(
            build=build.id,
            state=build.state,
            stage=build.stage,
            done=build.done,
            total=build.total,
            error=build.error,
            error_code=build.error_code,
            map_version=build.map_version,
            keyframes=report.get("keyframes"),
            connected=structure.get("connected"),
            chosen=structure.get("chosen"),
            left_out=report.get("discarded", {}),
            has_scale=report.get("placement", {}).get("has_scale"),
            camera=structure.get("camera"),
            warnings=report.get("warnings", []),
        )


class RecordingBody(BaseModel):
    """A recording as it is now."""

    model_config = ConfigDict(json_schema_extra={"example": EXAMPLE})

    recording: str
    venue: str
    frames: int = Field(description="Frames that are stored")
    bytes: int
    missing: list[int] = Field(
        description="Numbers below the largest one whose frame is not stored, the first"
    )
    build: RecordingBuild | None
    created_at: datetime

    @staticmethod
    def of(state: RecordingState) -> RecordingBody:
        """Return the body of a recording."""
        return RecordingBody(
            recording=state.recording.id,
            venue=state.recording.venue_id,
            frames=state.stored.frames,
            bytes=state.stored.bytes,
            missing=list(state.stored.missing[: OPTIONS.shown_missing]),
            build=None if state.build is None else RecordingBuild.of(state.build),
            created_at=state.recording.created_at,
        )


class EndOfRecording(RequestBody):
    """What ends a recording."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"frames": 180, "scale": {"marker_m": 0.16}, "mode": "replace"}}
    )

    frames: int = Field(ge=1, le=OPTIONS.max_frames, description="How many were filmed")
    scale: ScaleOption | None = Field(
        None, description="What is known of the size; frames have the names 000000.jpg, 000001.jpg, ..."
    )
    mode: Literal["replace", "extend"] = "replace"


class StoredFrameBody(BaseModel):
    """A frame that is stored."""

    model_config = ConfigDict(json_schema_extra={"example": {"number": 12}})

    number: int


@router.post("", name="beginRecording", status_code=201, responses=problems(401, 404, 422))
def begin(state: State, caller: CallerOf, body: NewRecording) -> RecordingBody:
    """Begin a recording."""
    venue = caller.venue_or_own(body.venue)
    if venue is None:
        raise InvalidInputError("venue must name the venue that is recorded.")
    return RecordingBody.of(state.services.recordings.begin(venue))


@router.get("/{recording}", name="getRecording", responses=problems(401, 404, 422))
def status(state: State, recording: RecordingId) -> RecordingBody:
    """Return how much of a recording is stored, and what became of it."""
    return RecordingBody.of(state.services.recordings.state(recording))


@router.put(
    "/{recording}/frames/{number}",
    name="putRecordedFrame",
    responses=problems(401, 404, 409, 413, 415, 422, 503),
    openapi_extra={"requestBody": PICTURE},
)
async def put_frame(
    state: State,
    recording: RecordingId,
    number: Number,
    request: Request,
    time_s: Annotated[float, Query(ge=0, le=1e9, allow_inf_nan=False, description="Since the first frame")],
    gravity: Annotated[
        str | None, Query(max_length=100, description="Direction of down in the camera's axes: x,y,z")
    ] = None,
) -> StoredFrameBody:
    """Store a frame, a JPEG; the same one sent again changes nothing. Frames may come in any order."""
    down = _gravity(gravity)
    picture = await image_of(request)
    service = state.services.recordings
    await state.executor.run(lambda: service.add(recording, number, picture, time_s, down))
    return StoredFrameBody(number=number)


@router.post(
    "/{recording}/finish",
    name="finishRecording",
    status_code=202,
    responses=problems(401, 404, 409, 422),
)
def finish(state: State, recording: RecordingId, body: EndOfRecording, request: Request) -> RecordingBody:
    """End a recording and queue the build of its map. After a build that failed it can be ended again, with another
    scale; sent again while it is built, or afterwards, the call changes nothing."""
    options: dict[str, Any] = {"mode": body.mode}
    if body.scale is not None:
        options["scale"] = body.scale.model_dump(exclude_none=True)
    service = state.services.recordings
    service.finish(recording, body.frames, options)
    state.runner.wake()
    found = service.state(recording)
    # Who recorded stands in the audit log, since the map serves from then on.
    request.scope[VENUE] = found.recording.venue_id
    return RecordingBody.of(found)


@router.delete("/{recording}", name="discardRecording", status_code=204, responses=problems(401, 404, 422))
def discard(state: State, recording: RecordingId) -> Response:
    """Delete a recording with its frames; a map that was built of it stays."""
    state.services.recordings.discard(recording)
    return Response(status_code=204)
