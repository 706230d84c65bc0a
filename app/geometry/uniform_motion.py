"""Poses of a camera that is carried straight on at an even speed, where a recording has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.geometry.se3 import Pose

# Faster than people run, a number is a mistake in its unit.
MAX_SPEED_M_S = 20.0
MAX_FPS = 1000.0


@dataclass(frozen=True, slots=True)
class UniformMotion:
    """A walk from `start` (x, y, z in world metres, z the camera's height) along `direction_deg`.

    The direction is counter-clockwise from world x, the speed in metres a second, `fps` the frames a second. The
    camera looks where it goes, upright. Raises `InvalidInputError` for values that can't be meant.
    """

    start: tuple[float, float, float]
    speed_m_s: float
    direction_deg: float
    fps: float

    def __post_init__(self) -> None:
        if not np.isfinite([*self.start, self.speed_m_s, self.direction_deg, self.fps]).all():
            raise InvalidInputError("Uniform motion needs finite numbers.")
        if not 0 < self.speed_m_s <= MAX_SPEED_M_S:
            raise InvalidInputError(f"speed_m_s must be above 0 and at most {MAX_SPEED_M_S:g}.")
        if not 0 < self.fps <= MAX_FPS:
            raise InvalidInputError(f"fps must be above 0 and at most {MAX_FPS:g} frames a second.")

    def position(self, frame: int) -> NDArray[np.float64]:
        """Return where (3,) the camera is at frame n: X0 + v n/m cos, Y0 + v n/m sin, at one height (B eq. 2)."""
        angle = np.radians(self.direction_deg)
        way_m = self.speed_m_s * frame / self.fps
        return np.array(self.start) + way_m * np.array([np.cos(angle), np.sin(angle), 0.0])

    def pose(self, frame: int) -> Pose:
        """Return the `world_from_camera` of frame n: upright, looking along the walk."""
        angle = np.radians(self.direction_deg)
        forward = np.array([np.cos(angle), np.sin(angle), 0.0])
        right, down = np.array([forward[1], -forward[0], 0.0]), np.array([0.0, 0.0, -1.0])
        return Pose(np.column_stack([right, down, forward]), self.position(frame))
