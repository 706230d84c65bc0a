"""How a scan's poses may be written other than the project writes them, and the way back.

A pose here is `scan_from_camera` with camera axes x right, y down, z forward. Axes are named by three letters, where
x, y and z point: `rdf` is right, down, forward (OpenCV), `rub` right, up, back (OpenGL, ARKit, Blender), `flu`
forward, left, up (ROS bodies), `ruf` right, up, forward (Unity, left-handed).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.geometry.se3 import Pose, quaternion_from_rotation, rotation_from_quaternion, rotation_from_vector
from app.geometry.turns import camera_from_turned

Array = NDArray[np.float64]
Direction = Literal["world_from_camera", "camera_from_world", "rotation_transposed"]
QuaternionOrder = Literal["xyzw", "wxyz"]

OWN_AXES = "rdf"
AXES_NAMES = {
    "opencv": "rdf",
    "opengl": "rub",
    "arkit": "rub",
    "blender": "rub",
    "ros": "flu",
    "unity": "ruf",
}
DIRECTIONS = ("world_from_camera", "camera_from_world", "rotation_transposed")
QUATERNION_ORDERS = ("xyzw", "wxyz")
_LETTERS = {
    "r": (1, 0, 0),
    "l": (-1, 0, 0),
    "d": (0, 1, 0),
    "u": (0, -1, 0),
    "f": (0, 0, 1),
    "b": (0, 0, -1),
}
# A left-handed world becomes right-handed by exchanging y and z: one whose y is up then has z up.
_MIRROR = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])


@dataclass(frozen=True, slots=True)
class PoseArrays:
    """Poses `scan_from_camera` in arrays: rotations (n, 3, 3) and positions (n, 3) in metres."""

    rotations: Array
    positions: Array

    @staticmethod
    def of(poses: Sequence[Pose]) -> PoseArrays:
        """Return the arrays of poses."""
        return PoseArrays(
            np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses])
        )

    def poses(self) -> list[Pose]:
        """Return the poses one by one."""
        return [Pose(r, t) for r, t in zip(self.rotations, self.positions, strict=True)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseConvention:
    """How the poses of a scan's files are written.

    `axes` are the camera's (see above). `poses` is the direction of the transforms; `rotation_transposed` stands for
    camera positions beside rotations camera_from_world. `rotate_deg` (0, 90, 180, 270) is by how much the pictures
    were turned counter-clockwise from the camera that the poses are of. The pose of a picture is that of its time
    plus `time_offset_s`. Positions have `position_scale` units per metre. `mount_deg` is the rotation vector, in
    degrees about the axes of the camera, of a camera that is mounted at an angle to the body whose poses are written.
    Raises `InvalidInputError` for values that can't be meant.
    """

    axes: str = OWN_AXES
    poses: Direction = "world_from_camera"
    quaternion: QuaternionOrder = "xyzw"
    rotate_deg: int = 0
    time_offset_s: float = 0.0
    position_scale: float = 1.0
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.axes not in ALL_AXES:
            raise InvalidInputError(
                f"axes must be one of {', '.join(AXES_NAMES)}, or say in three letters where the camera's x, y and z "
                "point, such as rdf: right, down, forward."
            )
        if self.poses not in DIRECTIONS or self.quaternion not in QUATERNION_ORDERS:
            raise InvalidInputError(
                f"poses must be one of {', '.join(DIRECTIONS)}, quaternion one of {', '.join(QUATERNION_ORDERS)}."
            )
        if self.rotate_deg not in (0, 90, 180, 270):
            raise InvalidInputError("rotate_deg must be 0, 90, 180 or 270 degrees counter-clockwise.")
        if not abs(self.time_offset_s) <= 3600:
            raise InvalidInputError("time_offset_s must be a number of seconds, at most an hour.")
        if not 1e-6 <= self.position_scale <= 1e6:
            raise InvalidInputError("position_scale must be a number above 0, in units per metre.")
        if not np.linalg.norm(self.mount_deg) <= 180:
            raise InvalidInputError("mount_deg must be a rotation vector [x, y, z] of at most 180 degrees.")

    @property
    def is_left_handed(self) -> bool:
        """Whether the axes are left-handed, and the scan's frame with them."""
        return bool(np.linalg.det(_own_from_written(self.axes)) < 0)

    def read(self, written: PoseArrays) -> PoseArrays:
        """Return the poses that are written so; times are not touched."""
        rotations, positions = written.rotations, written.positions / self.position_scale
        if self.quaternion == "wxyz":
            rotations = _reordered(rotations, (1, 2, 3, 0))
        if self.poses == "camera_from_world":
            rotations = rotations.transpose(0, 2, 1)
            positions = -np.einsum("nij,nj->ni", rotations, positions)
        elif self.poses == "rotation_transposed":
            rotations = rotations.transpose(0, 2, 1)
        if self.is_left_handed:
            rotations, positions = _MIRROR @ rotations, positions @ _MIRROR.T
        return PoseArrays(rotations @ self._body_from_camera(), positions)

    def written(self, poses: PoseArrays) -> PoseArrays:
        """Return poses as this convention writes them: the inverse of `read`."""
        rotations, positions = poses.rotations @ self._body_from_camera().T, poses.positions
        if self.is_left_handed:
            rotations, positions = _MIRROR @ rotations, positions @ _MIRROR.T
        if self.poses == "camera_from_world":
            positions = -np.einsum("nji,nj->ni", rotations, positions)
            rotations = rotations.transpose(0, 2, 1)
        elif self.poses == "rotation_transposed":
            rotations = rotations.transpose(0, 2, 1)
        if self.quaternion == "wxyz":
            rotations = _reordered(rotations, (3, 0, 1, 2))
        return PoseArrays(rotations, positions * self.position_scale)

    def _body_from_camera(self) -> Array:
        turn = camera_from_turned(self.rotate_deg // 90).rotation
        return _own_from_written(self.axes).T @ turn @ rotation_from_vector(np.radians(self.mount_deg))

    def direction_in_own(self, direction: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return a direction of the files' frame, such as gravity, in the frame of the poses that are read."""
        if not self.is_left_handed:
            return direction
        x, y, z = (_MIRROR @ np.array(direction)).tolist()
        return x, y, z

    def without_times(self) -> PoseConvention:
        """Return the convention with no time offset."""
        return replace(self, time_offset_s=0.0)


def parse_axes(name: str) -> str:
    """Return the three letters of axes given by a name or by letters; other text is returned as it is."""
    lower = name.lower()
    return AXES_NAMES.get(lower, lower)


def _all_axes() -> tuple[str, ...]:
    pairs = ("rl", "du", "fb")
    return tuple(
        "".join(letters[i] for i in order) for letters in product(*pairs) for order in permutations(range(3))
    )


def _own_from_written(axes: str) -> Array:
    """Return the matrix (3, 3) that moves directions from axes by letters to x right, y down, z forward."""
    return np.array([_LETTERS[letter] for letter in axes], dtype=np.float64).T


def _reordered(rotations: Array, order: tuple[int, int, int, int]) -> Array:
    quaternions = (quaternion_from_rotation(rotation)[list(order)] for rotation in rotations)
    return np.stack([rotation_from_quaternion(*q) for q in quaternions])


ALL_AXES = _all_axes()
