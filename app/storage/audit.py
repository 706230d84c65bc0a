"""The audit log: who changed what, and when."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, insert, select

from app.storage.db import as_utc, now
from app.storage.tables import audit


@dataclass(frozen=True, slots=True, kw_only=True)
class Act:
    """What an administrator did: `act` is the call (`DELETE /venues/{venue}`), `target` the path it was made to."""

    key_id: str | None
    key_name: str
    act: str
    target: str
    venue_id: str | None
    address: str | None


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """An act with its number, which grows with time, and its time."""

    id: int
    at: datetime
    act: Act


def record_act(connection: Connection, act: Act) -> None:
    """Add an act to the log."""
    values = {name: getattr(act, name) for name in Act.__slots__}
    values["target"] = act.target[:300]
    connection.execute(insert(audit).values(at=now(), **values))


def list_acts(
    connection: Connection, venue_id: str | None = None, before: int | None = None, count: int | None = None
) -> list[AuditEntry]:
    """Return entries, newest first: of a venue, or all; those before a number, at most `count`."""
    query = select(audit).order_by(audit.c.id.desc()).limit(count)
    if venue_id is not None:
        query = query.where(audit.c.venue_id == venue_id)
    if before is not None:
        query = query.where(audit.c.id < before)
    return [_entry(row) for row in connection.execute(query)]


def _entry(row: Row[tuple[Any, ...]]) -> AuditEntry:
    at = as_utc(row.at)
    assert at is not None  # noqa: S101 - the column is not nullable
    return AuditEntry(row.id, at, Act(**{name: getattr(row, name) for name in Act.__slots__}))
