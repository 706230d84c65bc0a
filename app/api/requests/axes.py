"""Axes of AR frameworks: requests and answers are converted here, at the edge, and nowhere else."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from app.api.requests.names import known_names, refuse_unknown_keys
from app.errors import InvalidInputError, InvalidPoseError
from app.geometry.se3 import Pose

AxesName = Literal["opencv", "arkit", "arcore", "webxr", "unity", "unreal", "ros"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """A convention, as its world and its camera axes written in those of Roomfix.

    The rows of `world` (3, 3) are its x, y and z in a world with z up; those of `camera` (3, 3) are its x, y and z in a
    camera with x right, y down, z forward. Both have the same determinant, 1 or, left-handed, -1.
    """

    name: AxesName
    world: NDArray[np.float64]
    camera: NDArray[np.float64]
    units_per_m: float = 1.0

    def pose_out(self, world_from_camera: Pose) -> Pose:
        """Return world_from_camera of a pose in Roomfix's axes, world and camera both in these axes and units."""
        rotation = self.world @ world_from_camera.rotation @ self.camera.T
        return Pose(rotation, self.units_per_m * self.world @ world_from_camera.translation)

    def pose_in(self, world_from_camera: Pose) -> Pose:
        """Return world_from_camera of a pose in these axes in Roomfix's own: the inverse of `pose_out`."""
        rotation = self.world.T @ world_from_camera.rotation @ self.camera
        return Pose(rotation, self.world.T @ world_from_camera.translation / self.units_per_m)

    def motion_in(self, last_from_camera: Pose) -> Pose:
        """Return a motion between two cameras of these axes in Roomfix's axes and metres."""
        rotation = self.camera.T @ last_from_camera.rotation @ self.camera
        return Pose(rotation, self.camera.T @ last_from_camera.translation / self.units_per_m)

    def direction_in(self, direction: Vector) -> Vector:
        """Return a direction in a camera of these axes in Roomfix's camera axes."""
        x, y, z = (float(value) for value in self.camera.T @ np.array(direction))
        return x, y, z

    def point_in(self, point: Vector) -> Vector:
        """Return a point in a world of these axes in Roomfix's world, in metres."""
        x, y, z = (float(value) for value in self.world.T @ np.array(point) / self.units_per_m)
        return x, y, z


def _rows(*rows: Vector) -> NDArray[np.float64]:
    return np.array(rows, dtype=np.float64)


# World with z up, or y up where -z then is Roomfix's y; left-handed ones exchange y and z, or turn y around.
Z_UP = np.eye(3)
Y_UP = _rows((1, 0, 0), (0, 0, 1), (0, -1, 0))
Y_UP_LEFT_HANDED = _rows((1, 0, 0), (0, 0, 1), (0, 1, 0))
Z_UP_LEFT_HANDED = _rows((1, 0, 0), (0, -1, 0), (0, 0, 1))
RIGHT_DOWN_FORWARD = np.eye(3)
RIGHT_UP_BACKWARD = _rows((1, 0, 0), (0, -1, 0), (0, 0, -1))
RIGHT_UP_FORWARD = _rows((1, 0, 0), (0, -1, 0), (0, 0, 1))
FORWARD_RIGHT_UP = _rows((0, 0, 1), (1, 0, 0), (0, -1, 0))
FORWARD_LEFT_UP = _rows((0, 0, 1), (-1, 0, 0), (0, -1, 0))

OPENCV = Axes("opencv", Z_UP, RIGHT_DOWN_FORWARD)
CONVENTIONS: dict[AxesName, Axes] = {
    "opencv": OPENCV,
    "arkit": Axes("arkit", Y_UP, RIGHT_UP_BACKWARD),
    "arcore": Axes("arcore", Y_UP, RIGHT_UP_BACKWARD),
    "webxr": Axes("webxr", Y_UP, RIGHT_UP_BACKWARD),
    "unity": Axes("unity", Y_UP_LEFT_HANDED, RIGHT_UP_FORWARD),
    "unreal": Axes("unreal", Z_UP_LEFT_HANDED, FORWARD_RIGHT_UP, units_per_m=100.0),
    "ros": Axes("ros", Z_UP, FORWARD_LEFT_UP),
}
NAMES: tuple[AxesName, ...] = get_args(AxesName)
IN_WORDS = f"Axes of gravity, motion, prior and poses, in request and answer: {', '.join(NAMES)}"
DEVICE_POSE_IN_WORDS = (
    "JSON {position, quaternion}: the camera's pose in the app's own session frame when the picture was taken, in the "
    "same axes; the answer then has session_from_world"
)


@dataclass(frozen=True, slots=True)
class Frames:
    """In which axes a request is answered, and where the camera was in the app's own frame (session_from_camera in
    those axes), None where that was not said."""

    axes: Axes = OPENCV
    session_from_camera: Pose | None = None

    def session_from_world(self, world_from_camera: Pose | None) -> Pose | None:
        """Return what moves points of the world into the app's own frame, both in these axes; None where the pose in
        one of them is not known."""
        if world_from_camera is None or self.session_from_camera is None:
            return None
        return self.session_from_camera @ self.axes.pose_out(world_from_camera).inverse()


def parse_frames(axes: str | None, device_pose: str | None) -> Frames:
    """Return the frames that the fields of a request name; raises `InvalidInputError`."""
    return Frames(parse_axes(axes), parse_pose(device_pose, "device_pose"))


def parse_axes(name: str | None) -> Axes:
    """Return the convention of a name, Roomfix's own for none; raises `InvalidInputError`."""
    wanted = (name or "").strip().lower()
    if not wanted:
        return OPENCV
    for known, axes in CONVENTIONS.items():
        if known == wanted:
            return axes
    raise InvalidInputError(f"axes must be one of {', '.join(NAMES)}.")


def parse_pose(text: str | None, name: str) -> Pose | None:
    """Return the pose of a field, None for an empty one; raises `InvalidInputError`."""
    if text is None or not text.strip():
        return None
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    return pose_of(value, name)


def pose_of(value: Any, name: str) -> Pose:
    """Return the pose that JSON values hold; raises `InvalidInputError`."""
    try:
        refuse_unknown_keys(value, known_names(("position", "quaternion")), name)
        refuse_unknown_keys(value["position"], known_names("xyz"), f"{name}.position")
        refuse_unknown_keys(value["quaternion"], known_names("xyzw"), f"{name}.quaternion")
        position = [float(value["position"][axis]) for axis in ("x", "y", "z")]
        quaternion = [float(value["quaternion"][axis]) for axis in ("x", "y", "z", "w")]
        return Pose.from_quaternion(position, quaternion)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError, InvalidPoseError):
        wanted = '{"position": {"x", "y", "z"}, "quaternion": {"x", "y", "z", "w"}}'
        raise InvalidInputError(f"{name} must be {wanted}, all finite numbers.") from None
