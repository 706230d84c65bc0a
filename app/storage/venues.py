"""Venues: what a map, its floors and its builds belong to."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, Row, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from app.errors import ConflictError, NotFoundError
from app.storage.db import as_utc, now
from app.storage.tables import venues


@dataclass(frozen=True, slots=True)
class Venue:
    """A venue and the map version that serves it, if any."""

    id: str
    name: str
    created_at: datetime
    active_map_version: int | None


def create_venue(connection: Connection, venue_id: str, name: str) -> Venue:
    """Add a venue; raises `ConflictError` when the id is taken."""
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
        raise NotFoundError(f"There is no venue {venue_id!r}.")
    return _venue(row)


def list_venues(connection: Connection) -> list[Venue]:
    """Return all venues by their id."""
    return [_venue(row) for row in connection.execute(select(venues).order_by(venues.c.id))]


def rename_venue(connection: Connection, venue_id: str, name: str) -> Venue:
    """Change a venue's name; raises `NotFoundError`."""
    connection.execute(update(venues).where(venues.c.id == venue_id).values(name=name))
    return get_venue(connection, venue_id)


def delete_venue(connection: Connection, venue_id: str) -> None:
    """Delete a venue with its floors, maps and builds; raises `NotFoundError`."""
    if connection.execute(delete(venues).where(venues.c.id == venue_id)).rowcount == 0:
        raise NotFoundError(f"There is no venue {venue_id!r}.")


def set_active_map(connection: Connection, venue_id: str, version: int) -> None:
    """Make a map version the one that serves the venue."""
    connection.execute(update(venues).where(venues.c.id == venue_id).values(active_map_version=version))


def _venue(row: Row[tuple[object, ...]]) -> Venue:
    created = as_utc(row.created_at)
    assert created is not None  # noqa: S101 - the column is not nullable
    return Venue(row.id, row.name, created, row.active_map_version)
