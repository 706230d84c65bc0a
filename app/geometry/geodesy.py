"""Conversion between longitude and latitude and metres east and north of an origin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# The ellipsoid of WGS 84: its semi-major axis and the square of its first eccentricity.
SEMI_MAJOR_AXIS_M = 6_378_137.0
ECCENTRICITY_SQUARED = 6.694379990141e-3
# Each step of the inverse divides the error by more than a thousand within 10 km.
INVERSE_STEPS = 6


def east_north_from_geodetic(points_deg: ArrayLike, origin_deg: ArrayLike) -> Array:
    """Return metres east and north (n, 2) of an origin for longitudes and latitudes (n, 2) in degrees.

    The plane is tangent to the WGS 84 ellipsoid at the origin; heights are zero. Within 10 km the error of a distance
    is about a millimetre per kilometre. Source: geodetic to earth-centred to local coordinates, textbook.
    """
    points = np.radians(np.asarray(points_deg, dtype=np.float64).reshape(-1, 2))
    origin = np.radians(np.asarray(origin_deg, dtype=np.float64).reshape(1, 2))
    moved = _earth_centred(points) - _earth_centred(origin)
    longitude, latitude = origin[0]
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    north = np.array(
        [
            -np.sin(latitude) * np.cos(longitude),
            -np.sin(latitude) * np.sin(longitude),
            np.cos(latitude),
        ]
    )
    return np.asarray(np.column_stack([moved @ east, moved @ north]))


def geodetic_from_east_north(points_m: ArrayLike, origin_deg: ArrayLike) -> Array:
    """Return longitudes and latitudes (n, 2) in degrees of metres east and north (n, 2) of an origin.

    The inverse of `east_north_from_geodetic` by Newton's method, with the ellipsoid's radii at the origin as slope.
    """
    wanted = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
    origin = np.asarray(origin_deg, dtype=np.float64).reshape(1, 2)
    latitude = np.radians(origin[0, 1])
    flat = 1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    parallel_m = SEMI_MAJOR_AXIS_M / np.sqrt(flat) * np.cos(latitude)
    meridian_m = SEMI_MAJOR_AXIS_M * (1 - ECCENTRICITY_SQUARED) / flat**1.5
    degrees_per_m = np.degrees(1 / np.array([parallel_m, meridian_m]))
    found = np.repeat(origin, len(wanted), axis=0)
    for _ in range(INVERSE_STEPS):
        found = found + (wanted - east_north_from_geodetic(found, origin)) * degrees_per_m
    return np.asarray(found)


def _earth_centred(points_rad: Array) -> Array:
    longitude, latitude = points_rad.T
    radius_m = SEMI_MAJOR_AXIS_M / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    return np.column_stack(
        [
            radius_m * np.cos(latitude) * np.cos(longitude),
            radius_m * np.cos(latitude) * np.sin(longitude),
            radius_m * (1 - ECCENTRICITY_SQUARED) * np.sin(latitude),
        ]
    )
