"""Typed client of a Roomfix server, sync (`Roomfix`) and async (`AsyncRoomfix`)."""

from __future__ import annotations

from roomfix_client.answers import (
    Accuracy,
    Build,
    Camera,
    GeoPose,
    Inspection,
    LocateResult,
    Origin,
    PlanPoint,
    Pose,
    Position,
    PushedFrame,
    Quaternion,
    Session,
    Token,
    TrackedFrame,
    Venue,
)
from roomfix_client.asynchronous import AsyncRoomfix
from roomfix_client.calls import Frame, Uploaded
from roomfix_client.errors import BuildError, RoomfixError
from roomfix_client.synchronous import Roomfix

__all__ = [
    "Accuracy",
    "AsyncRoomfix",
    "Build",
    "BuildError",
    "Camera",
    "Frame",
    "GeoPose",
    "Inspection",
    "LocateResult",
    "Origin",
    "PlanPoint",
    "Pose",
    "Position",
    "PushedFrame",
    "Quaternion",
    "Roomfix",
    "RoomfixError",
    "Session",
    "Token",
    "TrackedFrame",
    "Uploaded",
    "Venue",
]
