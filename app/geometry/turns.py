"""Images turned by quarters: which turn makes one upright, and what it does to camera and pose.

`turns` counts quarters counter-clockwise as seen, like `numpy.rot90`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from app.geometry.validation import unit_vector

# Looking further up or down than this cosine leaves, how the image is turned can't be told from gravity.
MIN_IN_IMAGE = 0.35


def upright_turns(gravity_in_camera: ArrayLike) -> int | None:
    """Return the quarters (0 to 3) by which an image must be turned to be upright, nearest to the truth.

    `gravity_in_camera` (3,) is the direction of down in camera axes, of any length. None for a camera that
    looks steeply up or down.
    """
    x, y, _ = unit_vector(gravity_in_camera, 3, "gravity")
    if np.hypot(x, y) < MIN_IN_IMAGE:
        return None
    # Down at the right (x) needs a turn clockwise, which is three counter-clockwise.
    return int(np.rint(np.arctan2(-x, y) / (np.pi / 2))) % 4


def turned_camera(camera: Camera, turns: int) -> Camera:
    """Return the camera of the image after `turns` quarters; lens distortion turns with it."""
    for _ in range(turns % 4):
        camera = _turned_once(camera)
    return camera


def _turned_once(camera: Camera) -> Camera:
    fx, fy, cx, cy = camera.params[:4]
    lens = camera.params[4:]
    if camera.model in ("OPENCV", "FULL_OPENCV"):
        k1, k2, p1, p2 = lens[:4]
        # (p2, p1) is a vector in the image: what was right is up, what was down is right.
        lens = (k1, k2, -p2, p1, *lens[4:])
    return Camera(camera.model, camera.height, camera.width, (fy, fx, cy, camera.width - 1 - cx, *lens))


def camera_from_turned(turns: int) -> Pose:
    """Return the motion from the turned image's camera axes back to the original ones."""
    return Pose(rotation_from_vector([0.0, 0.0, np.pi / 2 * (turns % 4)]), np.zeros(3))


def angle_to_down_deg(world_from_camera: Pose, gravity_in_camera: ArrayLike) -> float:
    """Return the angle in degrees between gravity as the pose puts it into the world, z up, and straight down."""
    down = world_from_camera.rotation @ unit_vector(gravity_in_camera, 3, "gravity")
    return float(np.degrees(np.arccos(np.clip(-down[2], -1.0, 1.0))))
