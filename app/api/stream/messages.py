"""The text messages of a session's stream, as the server reads and writes them."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.requests.axes import AxesName
from app.api.schemas import PoseBody
from app.api.sessions import FRAME, CameraField, TrackedFrame

MOTION: dict[str, Any] = {
    "position": {"x": 0.02, "y": 0.0, "z": 0.05},
    "quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}


class StreamHints(BaseModel):
    """What a client knows of the next frame, sent before it; each member may be left out or null.

    Poses and numbers may also be given as the text that a form of `/sessions/{session}/frames` holds.
    """

    model_config = ConfigDict(json_schema_extra={"example": {"timestamp": 12.3, "motion": MOTION}})

    camera: CameraField | None = Field(None, description="As in /locate, in place of the session's")
    gravity: list[float] | str | None = Field(
        None, description='Direction of down in camera axes, [x, y, z] or "x,y,z"'
    )
    motion: PoseBody | str | None = Field(
        None, description="This camera in the axes of the last frame's camera"
    )
    timestamp: float | str | None = Field(None, description="When it was taken, seconds of the phone's clock")
    axes: AxesName | None = Field(None, description="Axes of gravity, motion and poses, also of the answer")
    device_pose: PoseBody | str | None = Field(
        None, description="The camera's pose in the app's own frame; the answer then has session_from_world"
    )


class StreamedFrame(TrackedFrame):
    """The answer to a frame of a stream: that of `/sessions/{session}/frames`, and which frame it answers."""

    model_config = ConfigDict(json_schema_extra={"example": {**FRAME, "received": 12}})

    received: int = Field(description="The number of the frame on this connection, from 1")

    @staticmethod
    def of(frame: TrackedFrame, received: int) -> StreamedFrame:
        """Return the answer to a frame."""
        values = frame.model_dump(exclude_unset=True)
        return StreamedFrame.model_validate({**values, "received": received})


class StreamProblem(BaseModel):
    """What is wrong with a message; the stream goes on unless the connection is closed."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "type": "about:blank",
                "status": 415,
                "code": "unsupported_image",
                "detail": "This is not an image.",
                "received": 12,
            }
        }
    )

    type: str = "about:blank"
    status: int
    code: str = Field(description="Stable, for programs")
    detail: str = Field(description="A sentence for people: what to change")
    received: int | None = Field(
        description="The number of the frame, or of the last one before a bad hint; null for a message too large"
    )
