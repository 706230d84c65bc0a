"""Where on Earth a plan lies, for features in longitude and latitude."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.geometry.alignment import rotation_2d
from app.geometry.geodesy import east_north_from_geodetic
from app.limits import limit

NAMES = {"longitude": ("longitude", "lon", "lng"), "latitude": ("latitude", "lat")}
GEODETIC_CRS = ("crs84", "4326")


@dataclass(frozen=True, slots=True, kw_only=True)
class OriginOptions:
    """How far from its origin a feature may lie."""

    max_distance_m: float = limit(
        10_000.0,
        "Distance of a position in longitude and latitude from the origin.",
        chosen="By hand: no venue is larger, and swapped longitude and latitude are usually farther away.",
    )


OPTIONS = OriginOptions()


@dataclass(frozen=True, slots=True)
class Origin:
    """The longitude and latitude in degrees of the plan point `plan` in metres; east lies `rotation_deg`
    counter-clockwise from plan x."""

    longitude: float
    latitude: float
    rotation_deg: float
    plan: tuple[float, float]

    def plan_from_geodetic(self, points_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return plan metres (n, 2) of longitudes and latitudes (n, 2); raises `InvalidInputError`."""
        if np.abs(points_deg[:, 0]).max() > 180 or np.abs(points_deg[:, 1]).max() > 90:
            raise InvalidInputError(
                "with an origin, coordinates are longitude and latitude: within 180 and 90 degrees."
            )
        east_north = east_north_from_geodetic(points_deg, (self.longitude, self.latitude))
        distance_m = float(np.linalg.norm(east_north, axis=1).max())
        if distance_m > OPTIONS.max_distance_m:
            raise InvalidInputError(
                f"it lies {distance_m / 1000:,.0f} km from the origin; are longitude and latitude swapped?"
            )
        turned = east_north @ rotation_2d(math.radians(self.rotation_deg)).T
        return np.asarray(np.round(turned + self.plan, 4))


def read_origin(collection: Mapping[str, Any]) -> Origin | None:
    """Return the origin that a FeatureCollection names, None when its coordinates are plan metres.

    Raises `InvalidInputError` for an origin that can't be, or a `crs` in degrees without an origin.
    """
    value = collection.get("origin")
    if value is None:
        _refuse_degrees(collection.get("crs"))
        return None
    if not isinstance(value, Mapping):
        raise InvalidInputError('origin must be {"longitude", "latitude", "rotation_deg", "plan": [x, y]}.')
    longitude, latitude = (_number(value, *names) for names in NAMES.values())
    rotation_deg = _number(value, "rotation_deg", default=0.0)
    if abs(longitude) > 180 or abs(latitude) > 89:
        raise InvalidInputError("origin must have a longitude within 180 and a latitude within 89 degrees.")
    at = value.get("plan", [0.0, 0.0])
    if not isinstance(at, list) or len(at) != 2:
        raise InvalidInputError("origin.plan must be two numbers: the origin's place on the plan in metres.")
    x, y = (_number({"plan": number}, "plan") for number in at)
    return Origin(longitude, latitude, rotation_deg, (x, y))


def _number(value: Mapping[str, Any], *names: str, default: float | None = None) -> float:
    found = next((value[name] for name in names if name in value), default)
    if isinstance(found, bool) or not isinstance(found, int | float) or not abs(found) <= 1e6:
        raise InvalidInputError(f"origin.{names[0]} must be a number.")
    return float(found)


def _refuse_degrees(crs: object) -> None:
    """Say what is missing where old GeoJSON names a coordinate system in degrees."""
    properties = crs.get("properties") if isinstance(crs, Mapping) else None
    name = str(properties.get("name", "")).lower() if isinstance(properties, Mapping) else ""
    if name.endswith(GEODETIC_CRS):
        raise InvalidInputError(
            "crs says longitude and latitude: add origin with the longitude and latitude of plan (0, 0)."
        )
