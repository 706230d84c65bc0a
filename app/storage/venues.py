"""Venues: what a map, its floors and its builds belong to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime

from sqlalchemy import Connection, Row, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from app.engine.floors.earth import Earth, VenueOrigin
from app.engine.floors.floor import Floor
from app.errors import ConflictError, InvalidInputError, NotFoundError
from app.storage.db import as_utc, now
from app.storage.floors import get_floor
from app.storage.tables import venues

# Ids that no venue may have, since their address `/venues/{id}` is that of something else.
RESERVED_IDS = ("import",)


@dataclass(frozen=True, slots=True)
class Venue:
    """A venue, the map version that serves it, and where on Earth it lies, if that is known."""

    id: str
    name: str
    created_at: datetime
    active_map_version: int | None
    origin: VenueOrigin | None = None


def check_id(venue_id: str) -> None:
    """Raise `InvalidInputError` for an id that no venue may have."""
    if venue_id in RESERVED_IDS:
        raise InvalidInputError(
            f"No venue may have the id {venue_id!r}: /venues/{venue_id} is the address where venues are imported. "
            "Choose another id."
        )


def create_venue(connection: Connection, venue_id: str, name: str) -> Venue:
    """Add a venue; raises `ConflictError` when the id is taken, `InvalidInputError` when it is reserved."""
    check_id(venue_id)
    venue = Venue(venue_id, name, now(), None)
    try:
        connection.execute(insert(venues).values(id=venue.id, name=venue.name, created_at=venue.created_at))
    except IntegrityError:
        raise ConflictError(f"There is a venue {venue_id!r} already; PATCH changes its name.") from None
    return venue


def get_venue(connection: Connection, venue_id: str) -> Venue:
    """Return a venue; raises `NotFoundError`."""
    row = connection.execute(select(venues).where(venues.c.id == venue_id)).first()
    if row is None:
        raise _unknown(venue_id)
    return _venue(row)


def list_venues(connection: Connection) -> list[Venue]:
    """Return all venues by their id."""
    return [_venue(row) for row in connection.execute(select(venues).order_by(venues.c.id))]


def rename_venue(connection: Connection, venue_id: str, name: str) -> Venue:
    """Change a venue's name; raises `NotFoundError`."""
    connection.execute(update(venues).where(venues.c.id == venue_id).values(name=name))
    return get_venue(connection, venue_id)


def place_venue(connection: Connection, venue_id: str, origin: VenueOrigin | None) -> Venue:
    """Set where on Earth a venue lies, None for nowhere; raises `NotFoundError`, also for a floor that is not there."""
    if origin is not None and origin.floor is not None:
        get_floor(connection, venue_id, origin.floor)
    values = None if origin is None else asdict(origin)
    connection.execute(update(venues).where(venues.c.id == venue_id).values(origin=values))
    return get_venue(connection, venue_id)


def earth_of(connection: Connection, venue_id: str, floors: Sequence[Floor]) -> Earth | None:
    """Return a venue with these floors on Earth, None where it has no origin; raises `NotFoundError`."""
    row = connection.execute(select(venues.c.origin).where(venues.c.id == venue_id)).first()
    if row is None:
        raise _unknown(venue_id)
    return None if row.origin is None else Earth(VenueOrigin(**row.origin), floors)


def delete_venue(connection: Connection, venue_id: str) -> None:
    """Delete a venue with its floors, maps and builds; raises `NotFoundError`."""
    if connection.execute(delete(venues).where(venues.c.id == venue_id)).rowcount == 0:
        raise _unknown(venue_id)


def set_active_map(connection: Connection, venue_id: str, version: int) -> None:
    """Make a map version the one that serves the venue."""
    connection.execute(update(venues).where(venues.c.id == venue_id).values(active_map_version=version))


def _unknown(venue_id: str) -> NotFoundError:
    return NotFoundError(f"There is no venue {venue_id!r}.")


def _venue(row: Row[tuple[object, ...]]) -> Venue:
    created = as_utc(row.created_at)
    assert created is not None  # noqa: S101 - the column is not nullable
    origin = None if row.origin is None else VenueOrigin(**row.origin)
    return Venue(row.id, row.name, created, row.active_map_version, origin)
