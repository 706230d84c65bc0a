"""Poses of a camera that moves along a straight line at constant speed, for a recording without poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.geometry.se3 import Pose
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class UniformMotionOptions:
    """Which values a uniform motion accepts."""

    max_speed_m_s: float = limit(
        20.0,
        "Largest speed in metres per second.",
        chosen="By hand: nobody walks or runs faster, so a larger number is in another unit.",
    )
    max_frames_per_s: float = limit(
        1000.0,
        "Largest frame rate in frames per second.",
        chosen="By hand: no camera for scans is faster, so a larger number is in another unit.",
    )


OPTIONS = UniformMotionOptions()


@dataclass(frozen=True, slots=True)
class UniformMotion:
    """A walk from `start` (x, y, z in world metres, z the camera's height) along `direction_deg`.

    The direction is counter-clockwise from world x; `fps` are the frames per second. The upright camera looks in the
    direction of the walk. Raises `InvalidInputError` for values that are not finite or not plausible.
    """

    start: tuple[float, float, float]
    speed_m_s: float
    direction_deg: float
    fps: float

    def __post_init__(self) -> None:
        if not np.isfinite([*self.start, self.speed_m_s, self.direction_deg, self.fps]).all():
            raise InvalidInputError("Uniform motion needs finite numbers.")
        if not 0 < self.speed_m_s <= OPTIONS.max_speed_m_s:
            raise InvalidInputError(f"speed_m_s must be above 0 and at most {OPTIONS.max_speed_m_s:g}.")
        if not 0 < self.fps <= OPTIONS.max_frames_per_s:
            raise InvalidInputError(
                f"fps must be above 0 and at most {OPTIONS.max_frames_per_s:g} frames a second."
            )

    def position(self, frame: int) -> NDArray[np.float64]:
        """Return the camera's position (3,) at frame n: X0 + v n/m cos, Y0 + v n/m sin, z constant (B eq. 2)."""
        angle = np.radians(self.direction_deg)
        distance_m = self.speed_m_s * frame / self.fps
        return np.array(self.start) + distance_m * np.array([np.cos(angle), np.sin(angle), 0.0])

    def pose(self, frame: int) -> Pose:
        """Return the `world_from_camera` of frame n: upright, looking in the direction of the walk."""
        angle = np.radians(self.direction_deg)
        forward = np.array([np.cos(angle), np.sin(angle), 0.0])
        right, down = np.array([forward[1], -forward[0], 0.0]), np.array([0.0, 0.0, -1.0])
        return Pose(np.column_stack([right, down, forward]), self.position(frame))
