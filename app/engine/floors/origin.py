"""Where on Earth a plan lies, for features in longitude and latitude."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.sentences import short
from app.errors import InvalidInputError
from app.geometry.alignment import rotation_2d
from app.geometry.geodesy import east_north_from_geodetic
from app.limits import limit

NAMES = {"longitude": ("longitude", "lon", "lng"), "latitude": ("latitude", "lat")}
MEMBERS = frozenset({*NAMES["longitude"], *NAMES["latitude"], "rotation_deg", "plan", "height_m"})
# EPSG codes of longitude and latitude, in WGS 84 and in systems that differ from it by less than two metres.
GEODETIC_CODES = {"84", "4326", "4979", "4258", "4269", "4490"}
CODED = re.compile(r"(?:EPSG|ESRI|CRS)\D*(?:[\d.]+[:/]+)?(\d+)$", re.IGNORECASE)


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
    counter-clockwise from plan x. `height_m` is the height of the plan above the ellipsoid: higher up, a degree is
    longer."""

    longitude: float
    latitude: float
    rotation_deg: float
    plan: tuple[float, float]
    height_m: float = 0.0

    def plan_from_geodetic(self, points_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return plan metres (n, 2) of longitudes and latitudes (n, 2); raises `InvalidInputError`."""
        if np.abs(points_deg[:, 0]).max() > 180 or np.abs(points_deg[:, 1]).max() > 90:
            raise InvalidInputError(
                "with an origin, coordinates are longitude and latitude: within 180 and 90 degrees."
            )
        east_north = east_north_from_geodetic(points_deg, (self.longitude, self.latitude), self.height_m)
        distance_m = float(np.linalg.norm(east_north, axis=1).max())
        if distance_m > OPTIONS.max_distance_m:
            raise InvalidInputError(
                f"it lies {distance_m / 1000:,.0f} km from the origin; are longitude and latitude swapped?"
            )
        turned = east_north @ rotation_2d(math.radians(self.rotation_deg)).T
        return np.asarray(np.round(turned + self.plan, 4))


def read_origin(collection: Mapping[str, Any]) -> Origin | None:
    """Return the origin that a FeatureCollection names, None when its coordinates are plan metres.

    Raises `InvalidInputError` for an origin that can't be, a `crs` in degrees without an origin, and the `crs` of a map
    grid.
    """
    value = collection.get("origin")
    _check_crs(collection.get("crs"), value is not None)
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise InvalidInputError('origin must be {"longitude", "latitude", "rotation_deg", "plan": [x, y]}.')
    unknown = [key for key in value if key not in MEMBERS]
    if unknown:
        raise InvalidInputError(
            f"origin has no member {short(unknown[0])}: it takes longitude, latitude, rotation_deg, plan and height_m."
        )
    longitude, latitude = (_number(value, *names) for names in NAMES.values())
    rotation_deg = _number(value, "rotation_deg", default=0.0)
    height_m = _number(value, "height_m", default=0.0)
    if abs(longitude) > 180 or abs(latitude) > 89:
        raise InvalidInputError("origin must have a longitude within 180 and a latitude within 89 degrees.")
    at = value.get("plan", [0.0, 0.0])
    if not isinstance(at, list) or len(at) != 2:
        raise InvalidInputError("origin.plan must be two numbers: the origin's place on the plan in metres.")
    x, y = (_number({"plan": number}, "plan") for number in at)
    return Origin(longitude, latitude, rotation_deg, (x, y), height_m)


def _number(value: Mapping[str, Any], *names: str, default: float | None = None) -> float:
    found = next((value[name] for name in names if name in value), default)
    if isinstance(found, bool) or not isinstance(found, int | float) or not abs(found) <= 1e6:
        raise InvalidInputError(f"origin.{names[0]} must be a number.")
    return float(found)


def _check_crs(crs: object, has_origin: bool) -> None:
    """Raise for a coordinate system that is not the plan's; the member `crs` is of older GeoJSON."""
    name = _crs_name(crs)
    code = CODED.search(name)
    if code is None:
        return
    if code[1] not in GEODETIC_CODES:
        raise InvalidInputError(
            f"crs says {short(name)}, a map grid. Give plan metres without crs, or longitude and latitude (EPSG:4326) "
            "with origin."
        )
    if not has_origin:
        raise InvalidInputError(
            "crs says longitude and latitude: add origin with the longitude and latitude of plan (0, 0)."
        )


def _crs_name(crs: object) -> str:
    """Return the name of a `crs` member, empty when it has none."""
    if isinstance(crs, str):
        return crs.strip()
    properties = crs.get("properties") if isinstance(crs, Mapping) else None
    if not isinstance(properties, Mapping):
        return ""
    if "code" in properties:
        return f"EPSG:{properties['code']}"
    return str(properties.get("name", "")).strip()
