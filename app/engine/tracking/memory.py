"""What a session remembers, as JSON for the database."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.engine.query.placed import WORLD, Accuracy, PlacedPose
from app.engine.tracking.state import TrackingMemory
from app.geometry.se3 import Pose


def pose_to_json(pose: Pose | None) -> list[float] | None:
    """Return x y z qx qy qz qw."""
    return None if pose is None else [float(value) for value in (*pose.translation, *pose.quaternion)]


def pose_from_json(values: list[float] | None) -> Pose | None:
    """Return the pose of x y z qx qy qz qw."""
    return None if values is None else Pose.from_quaternion(values[:3], values[3:])


def memory_to_json(memory: TrackingMemory) -> dict[str, Any]:
    """Return a memory as JSON."""
    last, pending = memory.last, memory.pending
    return {
        "state": memory.state,
        "frame_from_camera": None if last is None else pose_to_json(last.frame_from_camera),
        "frame_id": memory.frame_id,
        "time_s": memory.time_s,
        "fix_position_m": memory.fix_accuracy.position_m,
        "fix_orientation_deg": memory.fix_accuracy.orientation_deg,
        "fix_scale_sigma": memory.fix_scale_sigma,
        "unaided_m": memory.unaided_m,
        "unaided_rad": memory.unaided_rad,
        "pending": None if pending is None else pose_to_json(pending.frame_from_camera),
        "pending_frame_id": WORLD if pending is None else pending.frame_id,
        "pending_time_s": memory.pending_time_s,
        "lens": list(memory.lens),
        "camera_position_m": memory.camera_sigma.position_m,
        "camera_orientation_deg": memory.camera_sigma.orientation_deg,
    }


def memory_from_json(values: Mapping[str, Any]) -> TrackingMemory:
    """Return the memory of JSON; that of a session without frames is empty."""
    if not values:
        return TrackingMemory()
    # Sessions that were stored before plan poses had a name of their own hold the pose as `world_from_camera`.
    last = values.get("frame_from_camera", values.get("world_from_camera"))
    return TrackingMemory(
        state=values["state"],
        last=_placed(last, values.get("frame_id", WORLD)),
        time_s=values["time_s"],
        fix_accuracy=Accuracy(values["fix_position_m"], values["fix_orientation_deg"]),
        fix_scale_sigma=values["fix_scale_sigma"],
        unaided_m=values["unaided_m"],
        unaided_rad=values["unaided_rad"],
        pending=_placed(values.get("pending"), values.get("pending_frame_id", WORLD)),
        pending_time_s=values["pending_time_s"],
        lens=tuple(values["lens"]) if "lens" in values else TrackingMemory().lens,
        camera_sigma=Accuracy(
            values.get("camera_position_m", 0.0), values.get("camera_orientation_deg", 0.0)
        ),
    )


def _placed(values: list[float] | None, frame_id: str) -> PlacedPose | None:
    pose = pose_from_json(values)
    return None if pose is None else PlacedPose(pose, frame_id)
