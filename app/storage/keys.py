"""Keys and tokens: whose they are, what they may do, and until when."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from sqlalchemy import ColumnElement, Connection, Row, delete, insert, or_, select, update

from app.errors import NotFoundError
from app.storage.db import as_utc, now
from app.storage.tables import keys

Scope = Literal["locate", "anchor", "record", "admin"]
TokenScope = Literal["locate", "record"]
Kind = Literal["key", "token"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """A key, or a token that was made with one; `venue_id` and `camera_id` limit it, None limits nothing."""

    id: str
    secret_sha256: str
    kind: Kind
    name: str
    scope: Scope
    venue_id: str | None
    camera_id: str | None
    parent_id: str | None
    created_by: str
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None

    def is_expired(self, moment: datetime) -> bool:
        """Whether the key is no longer valid at a time."""
        return self.expires_at is not None and self.expires_at <= moment


def add_key(connection: Connection, key: Key) -> None:
    """Store a key."""
    connection.execute(insert(keys).values(**{name: getattr(key, name) for name in Key.__slots__}))


def find_key(connection: Connection, key_id: str) -> Key | None:
    """Return a key, revoked or expired ones too; None if there is none of this id."""
    row = connection.execute(select(keys).where(keys.c.id == key_id)).first()
    return None if row is None else _key(row)


def get_key(connection: Connection, key_id: str, venue_id: str | None = None) -> Key:
    """Return a key or token, one of a venue if that is given; raises `NotFoundError`."""
    key = find_key(connection, key_id)
    if key is None or (venue_id is not None and key.venue_id != venue_id):
        raise NotFoundError(f"There is no key {key_id!r}.")
    return key


def list_keys(
    connection: Connection, venue_id: str | None = None, after: str = "", count: int | None = None
) -> list[Key]:
    """Return keys without tokens, by id: all of a venue, or all; those after an id, at most `count`."""
    query = select(keys).where(keys.c.kind == "key", keys.c.id > after).order_by(keys.c.id).limit(count)
    if venue_id is not None:
        query = query.where(keys.c.venue_id == venue_id)
    return [_key(row) for row in connection.execute(query)]


def has_valid_key(connection: Connection) -> bool:
    """Whether there is a key that is neither expired nor revoked."""
    return connection.execute(select(keys.c.id).where(keys.c.kind == "key", _is_valid())).first() is not None


def revoke_key(connection: Connection, key_id: str) -> None:
    """Revoke a key and the tokens that were made with it; one that is revoked already keeps its time."""
    own = or_(keys.c.id == key_id, keys.c.parent_id == key_id)
    connection.execute(update(keys).where(own, keys.c.revoked_at.is_(None)).values(revoked_at=now()))


def delete_old_tokens(connection: Connection, before: datetime) -> int:
    """Delete tokens that expired before a time; return their number."""
    old = (keys.c.kind == "token") & (keys.c.expires_at < before)
    return connection.execute(delete(keys).where(old)).rowcount


def note_use(connection: Connection, key_id: str) -> None:
    """Store that a key was used now."""
    connection.execute(update(keys).where(keys.c.id == key_id).values(last_used_at=now()))


def _is_valid() -> ColumnElement[bool]:
    return keys.c.revoked_at.is_(None) & or_(keys.c.expires_at.is_(None), keys.c.expires_at > now())


def _key(row: Row[tuple[Any, ...]]) -> Key:
    values = {name: getattr(row, name) for name in Key.__slots__}
    for name in ("created_at", "expires_at", "revoked_at", "last_used_at"):
        values[name] = as_utc(values[name])
    return Key(**values)
