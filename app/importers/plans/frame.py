"""Where on Earth a plan lies, in both directions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from app.errors import InvalidInputError
from app.geometry.alignment import rotation_2d
from app.geometry.geodesy import east_north_from_geodetic, geodetic_from_east_north
from app.importers.plans.model import Points
from app.limits import limit

# Plan coordinates are rounded to this, so that what is written and read again is the same number.
DECIMALS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameOptions:
    """How large an indoor map may be."""

    max_distance_m: float = limit(
        100_000.0,
        "Distance of a position from the others of its map, east or north.",
        chosen="By hand: no venue is larger, and swapped longitude and latitude are usually farther away.",
    )


OPTIONS = FrameOptions()


@dataclass(frozen=True, slots=True)
class Frame:
    """The plan point `plan` lies at `longitude` and `latitude` in degrees; east lies `rotation_deg` counter-clockwise
    from plan x."""

    longitude: float
    latitude: float
    rotation_deg: float = 0.0
    plan: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (self.longitude, self.latitude, self.rotation_deg, *self.plan)
        if not all(map(math.isfinite, numbers)) or abs(self.longitude) > 180 or abs(self.latitude) > 89:
            raise InvalidInputError(
                "An origin is a longitude within 180 and a latitude within 89 degrees, and finite numbers."
            )

    def plan_from_geodetic(self, points_deg: ArrayLike) -> Points:
        """Return plan metres (n, 2) of longitudes and latitudes (n, 2); raises `InvalidInputError`."""
        points = np.asarray(points_deg, dtype=np.float64).reshape(-1, 2)
        if not np.isfinite(points).all() or not (np.abs(points) <= (180.0, 90.0)).all():
            raise InvalidInputError(
                "A position is not a longitude within 180 and a latitude within 90 degrees."
            )
        east_north = east_north_from_geodetic(points, (self.longitude, self.latitude))
        if len(points) and float(np.abs(east_north).max()) > OPTIONS.max_distance_m:
            raise InvalidInputError("A position lies more than 100 km from the others.")
        turned = east_north @ rotation_2d(math.radians(self.rotation_deg)).T
        return np.asarray(np.round(turned + self.plan, DECIMALS))

    def geodetic_from_plan(self, points_m: ArrayLike) -> Points:
        """Return longitudes and latitudes (n, 2) in degrees of plan points (n, 2) in metres."""
        moved = np.asarray(points_m, dtype=np.float64).reshape(-1, 2) - self.plan
        east_north = moved @ rotation_2d(math.radians(self.rotation_deg))
        return geodetic_from_east_north(east_north, (self.longitude, self.latitude))

    def as_json(self) -> dict[str, Any]:
        """Return what `frame_from_json` reads."""
        return {
            "longitude": self.longitude,
            "latitude": self.latitude,
            "rotation_deg": self.rotation_deg,
            "plan": list(self.plan),
        }


def frame_from_json(value: object) -> Frame | None:
    """Return the frame that `Frame.as_json` wrote; None for anything else."""
    if not isinstance(value, Mapping):
        return None
    try:
        x, y = value["plan"]
        numbers = value["longitude"], value["latitude"], value["rotation_deg"]
        longitude, latitude, rotation_deg = map(float, numbers)
        return Frame(longitude, latitude, rotation_deg, (float(x), float(y)))
    except (KeyError, TypeError, ValueError):
        return None
