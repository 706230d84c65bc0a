"""Images rotated by quarter turns: the rotation that makes one upright, and its effect on camera and pose.

`turns` is the number of quarter turns counter-clockwise, as in `numpy.rot90`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from app.geometry.validation import unit_vector
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnOptions:
    """When gravity determines how an image is rotated."""

    min_gravity_in_image: float = limit(
        0.35,
        "Least length of gravity's part in the image plane, of a unit vector, that determines the quarter turn.",
        chosen="By hand: below it the camera looks more than about 70 degrees up or down.",
    )


OPTIONS = TurnOptions()


def upright_turns(gravity_in_camera: ArrayLike) -> int | None:
    """Return the number of quarter turns (0 to 3) after which an image is nearest to upright.

    `gravity_in_camera` (3,) is the direction of down in camera axes, of any length. None for a camera that
    looks steeply up or down.
    """
    x, y, _ = unit_vector(gravity_in_camera, 3, "gravity")
    if np.hypot(x, y) < OPTIONS.min_gravity_in_image:
        return None
    # Down at the right (x) needs one quarter turn clockwise, which is three counter-clockwise.
    return int(np.rint(np.arctan2(-x, y) / (np.pi / 2))) % 4


def turned_camera(camera: Camera, turns: int) -> Camera:
    """Return the camera of an image after `turns` quarter turns; lens distortion is rotated too."""
    for _ in range(turns % 4):
        camera = _turned_once(camera)
    return camera


def _turned_once(camera: Camera) -> Camera:
    fx, fy, cx, cy = camera.params[:4]
    lens = camera.params[4:]
    if camera.model in ("OPENCV", "FULL_OPENCV"):
        k1, k2, p1, p2 = lens[:4]
        # (p2, p1) is a vector in the image, which is rotated: right becomes up, down becomes right.
        lens = (k1, k2, -p2, p1, *lens[4:])
    return Camera(camera.model, camera.height, camera.width, (fy, fx, cy, camera.width - 1 - cx, *lens))


def camera_from_turned(turns: int) -> Pose:
    """Return the pose that maps the rotated image's camera axes to the original ones."""
    return Pose(rotation_from_vector([0.0, 0.0, np.pi / 2 * (turns % 4)]), np.zeros(3))


def angle_to_down_deg(world_from_camera: Pose, gravity_in_camera: ArrayLike) -> float:
    """Return the angle in degrees between gravity, mapped to the world by the pose, and straight down (-z)."""
    down = world_from_camera.rotation @ unit_vector(gravity_in_camera, 3, "gravity")
    return float(np.degrees(np.arccos(np.clip(-down[2], -1.0, 1.0))))
