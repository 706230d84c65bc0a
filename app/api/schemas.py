"""The bodies that several routes share."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.geometry.camera import Camera
from app.geometry.se3 import Pose

PROBLEM_MEDIA_TYPE = "application/problem+json"
# The content of a body or answer that is a file.
FILE_CONTENT: dict[str, Any] = {"schema": {"type": "string", "format": "binary"}}


class Position(BaseModel):
    """A point in metres."""

    x: float
    y: float
    z: float


class Quaternion(BaseModel):
    """A unit quaternion, scalar last."""

    x: float
    y: float
    z: float
    w: float


class PoseBody(BaseModel):
    """A pose, always world_from_camera."""

    position: Position
    quaternion: Quaternion

    @staticmethod
    def of(world_from_camera: Pose) -> PoseBody:
        """Return the body of a pose, to the micrometre."""
        x, y, z = (round(float(value), 6) for value in world_from_camera.translation)
        qx, qy, qz, qw = (round(float(value), 8) for value in world_from_camera.quaternion)
        return PoseBody(position=Position(x=x, y=y, z=z), quaternion=Quaternion(x=qx, y=qy, z=qz, w=qw))


class CameraBody(BaseModel):
    """Intrinsics by COLMAP's names, and where they come from."""

    model: str
    width: int
    height: int
    params: list[float]
    source: str | None = Field(None, description="request, exif, phone_database, search or unknown")

    @staticmethod
    def of(camera: Camera, source: str | None = None) -> CameraBody:
        """Return the body of a camera."""
        return CameraBody(
            model=camera.model,
            width=camera.width,
            height=camera.height,
            params=list(camera.params),
            source=source,
        )


class FieldProblem(BaseModel):
    """What is wrong with one field of a request."""

    field: str
    message: str


class Problem(BaseModel):
    """An error as RFC 9457 describes it, with a stable code."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "type": "about:blank",
                "title": "Not Found",
                "status": 404,
                "code": "not_found",
                "detail": "There is no venue 'museum'.",
            }
        }
    )

    type: str = "about:blank"
    title: str = Field(description="The status in words")
    status: int
    code: str = Field(description="Stable, for programs")
    detail: str = Field(description="A sentence for people: what to change")
    fields: list[FieldProblem] = Field([], description="Of an invalid request: field by field")


def problems(*statuses: int) -> dict[int | str, dict[str, object]]:
    """Return the OpenAPI description of a route's errors.

    Each may be a 503, since the database may be locked; one that needs a key may be a 403 and 429 too.
    """
    with_key = {403, 429} if 401 in statuses else set[int]()
    return {
        status: {"description": HTTPStatus(status).phrase, "content": {PROBLEM_MEDIA_TYPE: {}}}
        for status in sorted({*statuses, *with_key, 503})
    }
