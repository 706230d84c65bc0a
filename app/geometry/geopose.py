"""Poses on Earth as OGC GeoPose 1.0 writes them: a WGS 84 position, and an orientation against east, north and up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.geodesy import enu_from_earth, geodetic_from_enu
from app.geometry.se3 import Pose, quaternion_from_rotation

Array = NDArray[np.float64]

# The axes of the body are x forward, y left, z up; those of a camera x right, y down, z forward.
CAMERA_FROM_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
# Sine of an angle below which a body counts as looking straight up or down: then only the sum of yaw and roll is known.
MIN_HORIZONTAL = 1e-9


@dataclass(frozen=True, slots=True)
class GeoPose:
    """A body on Earth: longitude and latitude in degrees, height above the WGS 84 ellipsoid in metres, and the rotation
    (3, 3) from its axes (x forward, y left, z up) to east, north and up at its own position."""

    longitude: float
    latitude: float
    height_m: float
    enu_from_body: Array

    @property
    def quaternion(self) -> Array:
        """The unit quaternion (4,) `x y z w` of the orientation."""
        return quaternion_from_rotation(self.enu_from_body)

    @property
    def yaw_pitch_roll_deg(self) -> tuple[float, float, float]:
        """The angles of turns about z, then about the turned y, then about the twice turned x: yaw and roll -180 to
        180, pitch -90 to 90 degrees.

        Yaw is counter-clockwise from east, seen from above; a positive pitch looks down; a positive roll lowers the
        right side.
        """
        r = self.enu_from_body
        horizontal = float(np.hypot(r[0, 0], r[1, 0]))
        pitch = np.arctan2(-r[2, 0], horizontal)
        if horizontal < MIN_HORIZONTAL:
            yaw, roll = np.arctan2(-r[0, 1], r[1, 1]), 0.0
        else:
            yaw, roll = np.arctan2(r[1, 0], r[0, 0]), np.arctan2(r[2, 1], r[2, 2])
        return float(np.degrees(yaw)), float(np.degrees(pitch)), float(np.degrees(roll))


def geopose_of(enu_from_camera: Pose, origin: ArrayLike) -> GeoPose:
    """Return the GeoPose of a camera (x right, y down, z forward) whose pose is known in metres east, north and up of
    an origin (longitude, latitude, height).

    East, north and up at the camera differ from those at the origin by the curvature of Earth, a hundredth of a degree
    in a kilometre.
    """
    start = np.asarray(origin, dtype=np.float64)
    longitude, latitude, height_m = geodetic_from_enu(enu_from_camera.translation, start)[0]
    here_from_origin = enu_from_earth(longitude, latitude) @ enu_from_earth(start[0], start[1]).T
    rotation = here_from_origin @ enu_from_camera.rotation @ CAMERA_FROM_BODY
    return GeoPose(float(longitude), float(latitude), float(height_m), rotation)
