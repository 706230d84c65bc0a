"""Sessions: a phone that sends one frame after the other is tracked."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Depends, File, Form, Path, Query, Response, UploadFile
from pydantic import BaseModel, ConfigDict, Field

from app.api.bodies.anchor import StatedCamera
from app.api.bodies.guidance import SessionGuidance
from app.api.deps import ID_PATTERN, CallerOf, State, require
from app.api.locate import EXAMPLE, IN_OWN_AXES, LocateResultBody, _camera, _gravity, body_of
from app.api.requests.axes import (
    DEVICE_POSE_IN_WORDS,
    OPENCV,
    Axes,
    AxesName,
    Frames,
    parse_axes,
    parse_frames,
    parse_pose,
)
from app.api.requests.axes import IN_WORDS as AXES_IN_WORDS
from app.api.requests.contract_route import ContractRoute
from app.api.requests.described import CAMERA_TYPES, DescribedAs
from app.api.requests.fields import FIELDS
from app.api.requests.json_body import RequestBody
from app.api.schemas import PoseBody, problems
from app.engine.tracking.memory import pose_from_json
from app.errors import InvalidInputError
from app.geometry.se3 import Pose
from app.limits import limit
from app.services.session_answer import SessionResult
from app.services.sessions import SessionFrame
from app.storage.sessions import Session, SessionPoint
from app.vision.image_files.formats import FORMATS_IN_WORDS

router = APIRouter(
    prefix="/sessions",
    tags=["sessions"],
    dependencies=[Depends(require("locate"))],
    route_class=ContractRoute,
)
SessionId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$", description="The session's id")]
Destination = Annotated[
    str,
    Field(
        min_length=1,
        max_length=FIELDS.max_destination_characters,
        description="A landmark's id, or floor:x,y",
    ),
]
Language = Annotated[
    str, Field(pattern=r"^[A-Za-z]{2,8}(-[A-Za-z0-9]{1,8})*$", max_length=FIELDS.max_language_characters)
]
CameraField = Annotated[
    Any,
    DescribedAs(CAMERA_TYPES),
    Field(description='"fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]" or {model, width, height, params}, as in /locate'),
]
TrackingState = Literal["initializing", "tracking", "relocalized", "lost"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRequestOptions:
    """What a session's requests may hold."""

    max_motion_m: float = limit(
        100.0,
        "Largest distance between the cameras of two frames that `motion` may state.",
        chosen="By hand: nobody walks this far between two frames; more is a wrong unit or an error of the phone.",
    )
    max_timestamp_s: float = limit(
        1e12,
        "Largest absolute time of a frame.",
        chosen="By hand: far above seconds since 1970, and small enough to be subtracted without loss.",
    )
    default_points: int = limit(
        1000, "Points of the trajectory that GET returns by default.", chosen="By hand: a walk of minutes."
    )
    max_points: int = limit(
        100_000, "Largest number of points that GET returns.", chosen="By hand: a walk of hours."
    )


OPTIONS = SessionRequestOptions()


class NewSession(RequestBody):
    """A session to start."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"venue": "museum", "camera": "498,498.5,322.4,236.8", "language": "en"}
        }
    )

    venue: str = Field(pattern=ID_PATTERN)
    camera: CameraField | None = None
    destination: Destination | None = None
    language: Language | None = None
    share: bool = Field(False, description="Whether those who run the venue may see where this phone is")


class SessionChange(RequestBody):
    """What can be changed of a session; null takes a destination or a camera away."""

    model_config = ConfigDict(json_schema_extra={"example": {"destination": "entrance"}})

    camera: CameraField | None = None
    destination: Destination | None = None
    language: Language | None = None
    share: bool = Field(False, description="Whether those who run the venue may see where this phone is")


class TrajectoryPoint(BaseModel):
    """One frame of a trajectory: where it was on the plan and in the world, null where that is not known."""

    frame: int
    time_s: float
    tracking: TrackingState
    floor: str | None
    x: float | None
    y: float | None
    heading_deg: float | None
    pose: PoseBody | None
    position_m: float | None = Field(description="One sigma")

    @staticmethod
    def of(point: SessionPoint, axes: Axes = OPENCV) -> TrajectoryPoint:
        """Return the body of a point, its pose in the given axes."""
        pose = pose_from_json(point.pose)
        x, y, heading_deg = point.plan or (None, None, None)
        return TrajectoryPoint(
            frame=point.frame,
            time_s=point.time_s,
            tracking=point.tracking,
            floor=point.floor,
            x=x,
            y=y,
            heading_deg=heading_deg,
            pose=None if pose is None else PoseBody.of(axes.pose_out(pose)),
            position_m=point.position_m,
        )


POINT: dict[str, Any] = {
    "frame": 12,
    "time_s": 1.2,
    "tracking": "tracking",
    "floor": "0",
    "x": 14.865,
    "y": 17.163,
    "heading_deg": 307.5,
    "pose": EXAMPLE["pose"],
    "position_m": 0.017,
}
SESSION = "4d0f6a1be1f94bd0a5d54a1f0f3c2b7e"


FRAME: dict[str, Any] = {
    **EXAMPLE,
    "session": SESSION,
    "frame": 12,
    "tracking": "tracking",
    "unaided_m": 0.0,
    "trajectory": [POINT],
    "guidance": None,
}


class TrackedFrame(LocateResultBody):
    """The answer to a frame: that of /locate and what tracking adds to it."""

    model_config = ConfigDict(json_schema_extra={"example": FRAME})

    session: str
    frame: int = Field(description="Counts the frames that were answered, from 1")
    tracking: TrackingState
    unaided_m: float = Field(description="Path since a map or an anchor last said where the camera is")
    trajectory: list[TrajectoryPoint] = Field(description="The last points; GET returns all")
    guidance: SessionGuidance | None


class SessionCamera(StatedCamera):
    """A session's camera: as it was stated, or as it was found by a search."""

    source: Literal["search"] | None = Field(None, description="search, where it was found by one")


class SessionBody(BaseModel):
    """A session, and with GET where it went."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "session": SESSION,
                "venue": "museum",
                "camera": [498.0, 498.5, 322.4, 236.8],
                "destination": "entrance",
                "language": "en",
                "share": False,
                "tracking": "tracking",
                "frames": 12,
                "created_at": "2026-03-01T09:00:00Z",
                "expires_at": "2026-03-01T10:00:01Z",
                "trajectory": [POINT],
            }
        }
    )

    session: str
    venue: str
    camera: SessionCamera | list[float] | None
    destination: str | None
    language: str | None
    share: bool = Field(description="Whether those who run the venue may see where this phone is")
    tracking: TrackingState
    frames: int
    created_at: datetime
    expires_at: datetime = Field(description="Put off by every frame")
    trajectory: list[TrajectoryPoint] = []

    @staticmethod
    def of(
        session: Session,
        timeout: timedelta,
        points: list[SessionPoint] | None = None,
        axes: Axes = OPENCV,
    ) -> SessionBody:
        """Return the body of a session."""
        return SessionBody(
            session=session.id,
            venue=session.venue_id,
            camera=session.camera,
            destination=session.destination,
            language=session.language,
            share=session.share,
            tracking=session.memory.get("state", "initializing"),
            frames=session.frames,
            created_at=session.created_at,
            expires_at=session.active_at + timeout,
            trajectory=[TrajectoryPoint.of(point, axes) for point in points or []],
        )


@router.post(
    "",
    name="createSession",
    response_model_exclude_unset=True,
    status_code=201,
    responses=problems(401, 404, 422),
)
def create(state: State, caller: CallerOf, new: NewSession) -> SessionBody:
    """Start a session."""
    caller.check_venue(new.venue)
    service = state.services.sessions
    created = service.create(new.venue, new.camera, new.destination, new.language, share=new.share)
    return SessionBody.of(created, service.timeout)


@router.get(
    "/{session}", name="getSession", response_model_exclude_unset=True, responses=problems(401, 404, 422)
)
def get(
    state: State,
    session: SessionId,
    points: Annotated[
        int, Query(ge=0, le=OPTIONS.max_points, description="Newest points of the trajectory")
    ] = OPTIONS.default_points,
    axes: Annotated[AxesName, Query(description="Axes of the trajectory's poses")] = "opencv",
) -> SessionBody:
    """Return a session and where it went."""
    service = state.services.sessions
    trajectory = service.trajectory(session, points)
    return SessionBody.of(service.get(session), service.timeout, trajectory, parse_axes(axes))


@router.patch(
    "/{session}", name="changeSession", response_model_exclude_unset=True, responses=problems(401, 404, 422)
)
def change(state: State, session: SessionId, change: SessionChange) -> SessionBody:
    """Change destination, language, camera, or whether the phone is shown."""
    values = change.model_dump(include=change.model_fields_set)
    return SessionBody.of(state.services.sessions.change(session, values), state.services.sessions.timeout)


@router.delete("/{session}", name="deleteSession", status_code=204, responses=problems(401, 404, 422))
def remove(state: State, session: SessionId) -> Response:
    """End a session and delete where it went."""
    state.services.sessions.delete(session)
    return Response(status_code=204)


@router.post(
    "/{session}/frames",
    name="trackFrame",
    response_model_exclude_unset=True,
    responses=problems(401, 404, 409, 413, 415, 422, 503),
)
async def frame(
    state: State,
    session: SessionId,
    image: Annotated[UploadFile, File(description=FORMATS_IN_WORDS)],
    camera: Annotated[str | None, Form(description="As in /locate, in place of the session's")] = None,
    gravity: Annotated[str | None, Form(description='Direction of down in camera axes, "x,y,z"')] = None,
    motion: Annotated[
        str | None,
        Form(description="JSON {position, quaternion}: this camera in the axes of the last frame's camera"),
    ] = None,
    timestamp: Annotated[
        str | None, Form(description="When it was taken, seconds of the phone's clock")
    ] = None,
    axes: Annotated[str | None, Form(description=AXES_IN_WORDS)] = None,
    device_pose: Annotated[str | None, Form(description=DEVICE_POSE_IN_WORDS)] = None,
) -> TrackedFrame:
    """Answer one frame."""
    frames = parse_frames(axes, device_pose)
    request = session_frame(await image.read(), camera, gravity, motion, timestamp, axes=frames.axes)
    answer = await state.executor.run(lambda: state.services.sessions.process(session, request))
    state.metrics.observe_query(answer.result)
    return frame_body(answer, frames)


def session_frame(
    image: bytes,
    camera: str | None,
    gravity: str | None,
    motion: str | None,
    timestamp: str | None,
    *,
    axes: Axes = OPENCV,
) -> SessionFrame:
    """Return the frame of a request's fields; raises `InvalidInputError`."""
    return SessionFrame(
        image,
        _camera(camera),
        parse_motion(motion, axes),
        parse_timestamp(timestamp),
        _gravity(gravity, axes),
    )


def parse_motion(text: str | None, axes: Axes = OPENCV) -> Pose | None:
    """Return the relative pose of a field in Roomfix's axes; raises `InvalidInputError`."""
    given = parse_pose(text, "motion")
    if given is None:
        return None
    motion = axes.motion_in(given)
    if float(np.linalg.norm(motion.translation)) > OPTIONS.max_motion_m:
        raise InvalidInputError(
            f"motion is {np.linalg.norm(motion.translation):.4g} m long, and at most {OPTIONS.max_motion_m:g} m lie "
            "between two frames. Is it in millimetres, or a pose in the world?"
        )
    return motion


def parse_timestamp(text: str | None) -> float | None:
    """Return the seconds of a field; raises `InvalidInputError`."""
    if text is None or not text.strip():
        return None
    try:
        seconds = float(text)
    except ValueError:
        seconds = float("nan")
    if not np.isfinite(seconds):
        raise InvalidInputError("timestamp must be a finite number of seconds, such as 12.34.")
    if abs(seconds) > OPTIONS.max_timestamp_s:
        raise InvalidInputError(
            f"timestamp is {seconds:.4g} s. Is it in milliseconds or nanoseconds? Give seconds of the phone's clock."
        )
    return seconds


def frame_body(answer: SessionResult, frames: Frames = IN_OWN_AXES) -> TrackedFrame:
    """Return the body of an answer, its poses in the axes that were asked for."""
    located = body_of(answer.result, frames).model_dump()
    # On a floor whose plan has no place in the world there is a point on the plan and no pose.
    located["located"] = answer.result.reason is None
    return TrackedFrame(
        **located,
        session=answer.session,
        frame=answer.frame,
        tracking=answer.tracking,
        unaided_m=round(answer.unaided_m, 4),
        trajectory=[TrajectoryPoint.of(point, frames.axes) for point in answer.trajectory],
        guidance=answer.guidance,
    )
