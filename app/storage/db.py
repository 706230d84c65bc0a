"""The database: engine, migrations, and the two kinds of transaction."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event, text

MIGRATIONS_DIR = Path(__file__).parent.parent.parent / "migrations"
BUSY_TIMEOUT_MS = 15_000
# Any number that nothing else in the database locks.
BLOB_LOCK = 7_266_349


class Database:
    """A connection pool. `read` and `write` are the only ways in; a write is committed when its block ends."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._sqlite = url.startswith("sqlite")
        self.engine: Engine = create_engine(url, pool_pre_ping=not self._sqlite)
        if self._sqlite:
            event.listen(self.engine, "connect", _configure_sqlite)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Give a connection for queries that change nothing."""
        with self.engine.connect() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Give a connection whose changes are committed together, or not at all when the block raises."""
        with self.engine.connect() as connection:
            if self._sqlite:
                # Take the write lock first: a transaction that upgrades from reading can only fail.
                connection.exec_driver_sql("BEGIN IMMEDIATE")
            yield connection
            connection.commit()

    def migrate(self) -> None:
        """Bring the tables to the newest form."""
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS_DIR))
        config.attributes["engine"] = self.engine
        command.upgrade(config, "head")

    def ping(self) -> None:
        """Raise if the database doesn't answer."""
        with self.read() as connection:
            connection.execute(text("SELECT 1"))

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()


def _configure_sqlite(connection: Any, _record: Any) -> None:
    # The driver must not open transactions of its own: `write` does, with the lock it needs.
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.close()


def hold_blobs(connection: Connection) -> None:
    """Keep all blobs from being discarded by others until the transaction of a `write` ends."""
    # On SQLite any write does that.
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": BLOB_LOCK})


def now() -> datetime:
    """Return the present time, in UTC."""
    return datetime.now(UTC)


def as_utc(value: datetime | None) -> datetime | None:
    """Return a stored time with its zone, which SQLite drops."""
    return value.replace(tzinfo=UTC) if value is not None and value.tzinfo is None else value
