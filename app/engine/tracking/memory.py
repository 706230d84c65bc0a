"""What a session remembers, as JSON for the database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from app.engine.mapping.options import parse_camera
from app.engine.tracking.state import TrackingMemory
from app.geometry.camera import Camera
from app.geometry.se3 import Pose


def pose_to_json(pose: Pose | None) -> list[float] | None:
    """Return x y z qx qy qz qw."""
    return None if pose is None else [float(value) for value in (*pose.translation, *pose.quaternion)]


def pose_from_json(values: list[float] | None) -> Pose | None:
    """Return the pose of x y z qx qy qz qw."""
    return None if values is None else Pose.from_quaternion(values[:3], values[3:])


def memory_to_json(memory: TrackingMemory) -> dict[str, Any]:
    """Return a memory as JSON."""
    poses = {name: pose_to_json(getattr(memory, name)) for name in ("world_from_camera", "pending")}
    return {**{f.name: getattr(memory, f.name) for f in fields(memory)}, **poses}


def memory_from_json(values: Mapping[str, Any]) -> TrackingMemory:
    """Return the memory of JSON; that of a session without frames is empty."""
    poses = {name: pose_from_json(values.get(name)) for name in ("world_from_camera", "pending")}
    return TrackingMemory(**{**values, **poses})


def camera_to_json(camera: Camera | tuple[float, ...] | None) -> Any:
    """Return a camera, or the numbers of one, as JSON."""
    if isinstance(camera, Camera):
        return {
            "model": camera.model,
            "width": camera.width,
            "height": camera.height,
            "params": list(camera.params),
        }
    return None if camera is None else list(camera)


def camera_from_json(values: Any) -> Camera | tuple[float, ...] | None:
    """Return the camera, or the numbers of one, of JSON."""
    return parse_camera(values)
