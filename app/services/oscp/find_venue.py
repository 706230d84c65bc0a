"""Which venue a phone is in, by a rough position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.errors import AmbiguousVenueError, InvalidInputError, NoVenueError
from app.geometry.geodesy import enu_from_geodetic
from app.limits import limit
from app.services.resources import Resources
from app.storage.venues import Venue, list_venues


@dataclass(frozen=True, slots=True, kw_only=True)
class FindVenueOptions:
    """How far from a venue's origin a phone may be."""

    max_distance_m: float = limit(
        1000.0,
        "Largest distance of a phone's rough position from the origin of the venue that it is in.",
        chosen="By hand: an airport's terminal is as long, and a position by mobile network is off by some hundred "
        "metres.",
    )
    accuracy_m: float = limit(
        50.0,
        "Error of a rough position that states none.",
        chosen="By hand: satellites seen through windows give some ten metres.",
    )


OPTIONS = FindVenueOptions()


@dataclass(frozen=True, slots=True)
class RoughPosition:
    """Longitude and latitude in degrees, and how far off they may be in metres, None where that is not known."""

    longitude: float
    latitude: float
    accuracy_m: float | None = None


def find_venue(resources: Resources, at: RoughPosition | None) -> str:
    """Return the venue whose origin is nearest to a position, or without a position the only one that has an origin.

    Raises `NoVenueError` when none is within `OPTIONS.max_distance_m`, `AmbiguousVenueError` when another one may be
    the nearest if the position is off by its accuracy, and `InvalidInputError` when there is no position to choose by.
    """
    with resources.database.read() as connection:
        venues = [venue for venue in list_venues(connection) if venue.origin is not None]
    if not venues:
        raise NoVenueError("No venue here has a place on Earth: an administrator sets the origin of one.")
    if at is None:
        if len(venues) > 1:
            raise InvalidInputError(
                f"There are {len(venues)} venues: send a geolocation reading, or name one in the query as venue."
            )
        return venues[0].id
    return _nearest(venues, at)


def _nearest(venues: list[Venue], at: RoughPosition) -> str:
    distances_m = {venue.id: _distance_m(venue, at) for venue in venues}
    nearest, *others = sorted(distances_m, key=lambda venue: (distances_m[venue], venue))
    if distances_m[nearest] > OPTIONS.max_distance_m:
        raise NoVenueError(
            f"No venue is within {OPTIONS.max_distance_m:,.0f} m of this position; the nearest is "
            f"{distances_m[nearest] / 1000:,.1f} km away."
        )
    accuracy_m = at.accuracy_m or OPTIONS.accuracy_m
    # The phone may be nearer to the second by the accuracy, and as much farther from the first.
    if others and distances_m[others[0]] - distances_m[nearest] < 2 * accuracy_m:
        raise AmbiguousVenueError(
            f"With an accuracy of {accuracy_m:,.0f} m this position may be in {nearest!r} or {others[0]!r}: name the "
            "venue in the query, or send a key of one venue."
        )
    return nearest


def _distance_m(venue: Venue, at: RoughPosition) -> float:
    """Return the straight distance from a venue's origin, heights left out."""
    assert venue.origin is not None  # noqa: S101 - chosen so
    origin = (venue.origin.longitude, venue.origin.latitude, 0.0)
    return float(np.linalg.norm(enu_from_geodetic([(at.longitude, at.latitude, 0.0)], origin)))
