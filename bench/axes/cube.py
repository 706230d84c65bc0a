"""A cube and a camera, written in the axes of each framework, and where the framework's camera sees the corners."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from app.api.requests.axes import CONVENTIONS, AxesName
from app.geometry.se3 import Pose

Array = NDArray[np.float64]

FOCAL_PX = 600.0
WIDTH_PX = 400
HEIGHT_PX = 340
SIDE_M = 1.0
# Where the camera stands, and what it looks at.
EYE_M = np.array([3.5, -4.5, 3.0])
TARGET_M = np.array([0.4, 0.2, 0.5])


@dataclass(frozen=True, slots=True)
class Directions:
    """What is to the right, above and ahead of a camera, in the camera's own axes as the framework documents them."""

    right: tuple[int, int, int]
    up: tuple[int, int, int]
    forward: tuple[int, int, int]


OPENGL = Directions(right=(1, 0, 0), up=(0, 1, 0), forward=(0, 0, -1))
DIRECTIONS: dict[AxesName, Directions] = {
    "opencv": Directions(right=(1, 0, 0), up=(0, -1, 0), forward=(0, 0, 1)),
    "arkit": OPENGL,
    "arcore": OPENGL,
    "webxr": OPENGL,
    "unity": Directions(right=(1, 0, 0), up=(0, 1, 0), forward=(0, 0, 1)),
    "unreal": Directions(right=(0, 1, 0), up=(0, 0, 1), forward=(1, 0, 0)),
    "ros": Directions(right=(0, -1, 0), up=(0, 0, 1), forward=(1, 0, 0)),
}


def camera_pose() -> Pose:
    """Return world_from_camera of the camera, in Roomfix's axes: level, its target in the middle."""
    forward = (TARGET_M - EYE_M) / np.linalg.norm(TARGET_M - EYE_M)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Pose(np.column_stack([right, np.cross(forward, right), forward]), EYE_M)


def corners_m() -> Array:
    """Return the corners (8, 3) of the cube in Roomfix's world: one at the origin, sides along the axes."""
    return SIDE_M * np.array(list(product((0.0, 1.0), repeat=3)))


def points_in(name: AxesName, points_in_world: Array) -> Array:
    """Return points (n, 3) of Roomfix's world in the world of a convention, in its units."""
    axes = CONVENTIONS[name]
    return np.array([axes.pose_out(Pose(np.eye(3), point)).translation for point in points_in_world])


def seen_by(name: AxesName, points: Array, world_from_camera: Pose) -> Array:
    """Return the pixels (n, 2) at which a camera of a convention sees points (n, 3), both as the convention has them.

    Nothing of Roomfix is in it: right, above and ahead are those of the framework.
    """
    in_camera = (points - world_from_camera.translation) @ world_from_camera.rotation
    own = DIRECTIONS[name]
    right, up, ahead = (in_camera @ np.array(each) for each in (own.right, own.up, own.forward))
    return np.column_stack(
        [
            (WIDTH_PX - 1) / 2 + FOCAL_PX * right / ahead,
            (HEIGHT_PX - 1) / 2 - FOCAL_PX * up / ahead,
        ]
    )


def pixels_of(name: AxesName, points_in_world: Array) -> Array:
    """Return the pixels (n, 2) at which the camera sees points of Roomfix's world, by way of a convention."""
    return seen_by(name, points_in(name, points_in_world), CONVENTIONS[name].pose_out(camera_pose()))
