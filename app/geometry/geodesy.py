"""Conversion between geodetic positions (WGS 84) and metres east, north and up of an origin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# The ellipsoid of WGS 84: its semi-major axis and the square of its first eccentricity.
SEMI_MAJOR_AXIS_M = 6_378_137.0
ECCENTRICITY_SQUARED = 6.694379990141e-3
# Each step of the inverse divides the error by more than a thousand within 10 km.
INVERSE_STEPS = 6
# Each step from earth-centred to geodetic coordinates divides the error of the latitude by more than a hundred.
LATITUDE_STEPS = 8


def east_north_from_geodetic(points_deg: ArrayLike, origin_deg: ArrayLike, height_m: float = 0.0) -> Array:
    """Return metres east and north (n, 2) of an origin for longitudes and latitudes (n, 2) in degrees.

    All of them lie `height_m` above the WGS 84 ellipsoid; the plane is tangent to that surface at the origin. Within
    10 km the error of a distance is about a millimetre per kilometre. Source: geodetic to earth-centred to local
    coordinates, textbook.
    """
    points = np.radians(np.asarray(points_deg, dtype=np.float64).reshape(-1, 2))
    origin = np.radians(np.asarray(origin_deg, dtype=np.float64).reshape(1, 2))
    moved = _earth_centred(points, height_m) - _earth_centred(origin, height_m)
    longitude_deg, latitude_deg = np.asarray(origin_deg, dtype=np.float64).reshape(2)
    east, north, _ = enu_from_earth(longitude_deg, latitude_deg)
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


def enu_from_earth(longitude_deg: float, latitude_deg: float) -> Array:
    """Return the rotation (3, 3) from earth-centred axes to east, north and up at a position: the directions of east,
    north and up are its rows."""
    longitude, latitude = np.radians(longitude_deg), np.radians(latitude_deg)
    return np.array(
        [
            [-np.sin(longitude), np.cos(longitude), 0.0],
            [
                -np.sin(latitude) * np.cos(longitude),
                -np.sin(latitude) * np.sin(longitude),
                np.cos(latitude),
            ],
            [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)],
        ]
    )


def enu_from_geodetic(points: ArrayLike, origin: ArrayLike) -> Array:
    """Return metres east, north and up (n, 3) of an origin for geodetic positions (n, 3).

    A geodetic position is longitude and latitude in degrees and the height above the ellipsoid of WGS 84 in metres.
    The plane is tangent to the ellipsoid's parallel surface at the origin. Source: geodetic to earth-centred to local
    coordinates, textbook.
    """
    wanted = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    start = np.asarray(origin, dtype=np.float64).reshape(1, 3)
    moved = _earth_centred_deg(wanted) - _earth_centred_deg(start)
    return np.asarray(moved @ enu_from_earth(start[0, 0], start[0, 1]).T)


def geodetic_from_enu(points_m: ArrayLike, origin: ArrayLike) -> Array:
    """Return geodetic positions (n, 3), as in `enu_from_geodetic`, of metres east, north and up (n, 3) of an origin."""
    wanted = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    start = np.asarray(origin, dtype=np.float64).reshape(1, 3)
    return _geodetic(_earth_centred_deg(start) + wanted @ enu_from_earth(start[0, 0], start[0, 1]))


def _earth_centred_deg(points: Array) -> Array:
    return _earth_centred(np.radians(points[:, :2]), points[:, 2])


def _earth_centred(points_rad: Array, heights_m: Array | float = 0.0) -> Array:
    longitude, latitude = points_rad.T
    radius_m = SEMI_MAJOR_AXIS_M / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    return np.column_stack(
        [
            (radius_m + heights_m) * np.cos(latitude) * np.cos(longitude),
            (radius_m + heights_m) * np.cos(latitude) * np.sin(longitude),
            (radius_m * (1 - ECCENTRICITY_SQUARED) + heights_m) * np.sin(latitude),
        ]
    )


def _geodetic(points_m: Array) -> Array:
    """Return geodetic positions (n, 3) of earth-centred points (n, 3), by fixed-point iteration of the latitude."""
    x, y, z = points_m.T
    from_axis_m = np.hypot(x, y)
    latitude = np.arctan2(z, from_axis_m * (1 - ECCENTRICITY_SQUARED))
    for _ in range(LATITUDE_STEPS):
        radius_m = SEMI_MAJOR_AXIS_M / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + ECCENTRICITY_SQUARED * radius_m * np.sin(latitude), from_axis_m)
    sin, cos = np.sin(latitude), np.cos(latitude)
    heights_m = from_axis_m * cos + z * sin - SEMI_MAJOR_AXIS_M * np.sqrt(1 - ECCENTRICITY_SQUARED * sin**2)
    return np.column_stack([np.degrees(np.arctan2(y, x)), np.degrees(latitude), heights_m])
