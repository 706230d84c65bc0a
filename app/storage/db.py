"""The database: engine, migrations, and the two kinds of transaction."""

from __future__ import annotations

import logging
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.exc import DBAPIError

from app.errors import DatabaseBusyError, DatabaseDamagedError, StorageError, StorageFullError
from app.limits import limit

T = TypeVar("T")

log = logging.getLogger("roomfix.storage")
MIGRATIONS_DIR = Path(__file__).parent.parent.parent / "migrations"
# Any number that nothing else in the database locks.
BLOB_LOCK = 7_266_349
MIGRATION_LOCK = 7_266_350
# Result codes of SQLite for a lock that another connection holds; the higher bits say more.
SQLITE_LOCK_CODES = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
FULL = "No space is left on the disk of the database; free some, nothing was stored."
UNUSABLE = (
    "The database can't be read or written: its disk is read-only, or fails. An operator has to look at it."
)
MALFORMED = "The file of the database is damaged. `roomfix restore --replace` brings it back from a backup."
STORAGE_ERRORS: dict[int, tuple[type[StorageError], str]] = {
    sqlite3.SQLITE_FULL: (StorageFullError, FULL),
    sqlite3.SQLITE_READONLY: (StorageError, UNUSABLE),
    sqlite3.SQLITE_IOERR: (StorageError, UNUSABLE),
    sqlite3.SQLITE_CANTOPEN: (StorageError, UNUSABLE),
    sqlite3.SQLITE_CORRUPT: (DatabaseDamagedError, MALFORMED),
    sqlite3.SQLITE_NOTADB: (DatabaseDamagedError, MALFORMED),
}
# What SQLite says of our own statements where the file no longer holds the tables that the migration made.
MISSING_SCHEMA = ("no such table", "no such column", "malformed database schema")
# SQLSTATE of PostgreSQL for a lock that was not given in time, and for transactions that stood in each other's way.
LOCK_NOT_AVAILABLE = "55P03"
SERIALIZATION_FAILURE = "40001"
DEADLOCK_DETECTED = "40P01"
LOCKED = "Another program holds the lock of the database, such as a backup or a database browser. Try again."
COLLIDED = "Another transaction of the database was in the way of this one. Try again."
SENTENCES = {LOCK_NOT_AVAILABLE: LOCKED, SERIALIZATION_FAILURE: COLLIDED, DEADLOCK_DETECTED: COLLIDED}


@dataclass(frozen=True, slots=True, kw_only=True)
class DatabaseOptions:
    """How long a lock is waited for."""

    lock_wait_s: float = limit(
        15.0,
        "Time that a transaction waits for a lock before it fails.",
        chosen="By hand: longer than any transaction of our own, of which the sweep's is the longest.",
    )
    patient_wait_s: float = limit(
        1.0,
        "The same for a process that tries again until it has the lock of SQLite.",
        chosen="By hand: a signal to stop the process is not handled before the end of this.",
    )
    retry_s: float = limit(
        0.05,
        "Pause before such a process tries again.",
        chosen="By hand: no load, and no delay that matters.",
    )


OPTIONS = DatabaseOptions()


class Database:
    """A connection pool. `read` and `write` are the only ways in; a write is committed when its block ends.

    When another program holds a lock for too long, or PostgreSQL ends a transaction that stood in the way of another
    one, both raise `DatabaseBusyError`. With `is_patient` they wait for a lock as long as it takes, which suits a
    worker but no server.
    """

    def __init__(self, url: str, *, is_patient: bool = False) -> None:
        self.url = url
        self._sqlite = url.startswith("sqlite")
        self._is_patient = is_patient
        self._postgresql = url.startswith("postgresql")
        self.engine: Engine = create_engine(url, pool_pre_ping=not self._sqlite)
        if self._sqlite:
            event.listen(self.engine, "connect", self._configure_sqlite)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Give a connection for queries that change nothing."""
        with _locks_translated(), self._connect() as connection:
            yield connection

    @contextmanager
    def write(self, wait_s: float | None = None) -> Iterator[Connection]:
        """Give a connection whose changes are committed together, or not at all when the block raises.

        `wait_s` replaces the time that a lock is waited for.
        """
        with _locks_translated(), self._connect() as connection:
            if self._sqlite:
                # The write lock is taken first, since a transaction that upgrades from reading can only fail.
                self._begin(connection, wait_s)
            elif self._postgresql and not (self._is_patient and wait_s is None):
                wait_ms = round(1e3 * (OPTIONS.lock_wait_s if wait_s is None else wait_s))
                connection.exec_driver_sql(f"SET LOCAL lock_timeout = {wait_ms}")
            yield connection
            connection.commit()

    def migrate(self) -> None:
        """Bring the tables to the newest form; waits for the lock while another program holds it."""
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS_DIR))
        config.attributes["engine"] = self.engine
        if _when_free(lambda: self._is_current(config)):
            return
        if self._sqlite:
            with self.engine.connect() as connection:
                _when_free(lambda: connection.exec_driver_sql("BEGIN IMMEDIATE"))
        if self._sqlite:
            command.upgrade(config, "head")
            return
        with self.engine.connect() as connection:
            # Of servers that start together one brings the tables up to date.
            connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": MIGRATION_LOCK})
            try:
                command.upgrade(config, "head")
            finally:
                connection.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": MIGRATION_LOCK})

    def ping(self) -> None:
        """Raise if the database doesn't answer."""
        with self.read() as connection:
            connection.execute(text("SELECT 1"))

    @contextmanager
    def notices(self, channel: str) -> Iterator[Callable[[float], bool]]:
        """Give a function that waits for a notice by `notify`, at most for some seconds, and returns whether there was
        one. Only PostgreSQL has notices, and a pooler between may lose them all: they can only save a wait."""
        with self.engine.connect() as connection:
            driver: Any = connection.connection.driver_connection
            # Not back to the pool, whose connections listen to nothing.
            connection.detach()
            driver.autocommit = True
            driver.execute(f'LISTEN "{channel}"')

            def wait(seconds: float) -> bool:
                return any(True for _ in driver.notifies(timeout=seconds, stop_after=1))

            yield wait

    @property
    def has_notices(self) -> bool:
        """Whether the database has notices."""
        return self._postgresql

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

    def _connect(self) -> Connection:
        return _when_free(self.engine.connect) if self._is_patient else self.engine.connect()

    def _begin(self, connection: Connection, wait_s: float | None) -> None:
        if self._is_patient:
            _when_free(lambda: connection.exec_driver_sql("BEGIN IMMEDIATE"))
        elif wait_s is None:
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        else:
            _set_lock_wait(connection, wait_s)
            try:
                connection.exec_driver_sql("BEGIN IMMEDIATE")
            finally:
                _set_lock_wait(connection, self._lock_wait_s)

    @property
    def _lock_wait_s(self) -> float:
        return OPTIONS.patient_wait_s if self._is_patient else OPTIONS.lock_wait_s

    def _is_current(self, config: Config) -> bool:
        """Return whether the tables have the newest form already."""
        heads = set(ScriptDirectory.from_config(config).get_heads())
        with self.engine.connect() as connection:
            return set(MigrationContext.configure(connection).get_current_heads()) == heads

    def _configure_sqlite(self, connection: Any, _record: Any) -> None:
        # The driver must not open transactions of its own: `write` does, with the lock it needs.
        connection.isolation_level = None
        cursor = connection.cursor()
        cursor.execute(f"PRAGMA busy_timeout = {round(1e3 * self._lock_wait_s)}")
        cursor.execute("PRAGMA journal_mode = WAL")
        cursor.execute("PRAGMA synchronous = FULL")
        cursor.execute("PRAGMA foreign_keys = ON")
        cursor.close()


def _set_lock_wait(connection: Connection, wait_s: float) -> None:
    connection.exec_driver_sql(f"PRAGMA busy_timeout = {round(1e3 * wait_s)}")


def _when_free(action: Callable[[], T]) -> T:
    """Return what an action returns, tried until no other program's lock stops it."""
    is_waiting = False
    while True:
        try:
            with _locks_translated():
                return action()
        except DatabaseBusyError:
            if not is_waiting:
                log.warning("another program holds the lock of the database; waiting for it")
                is_waiting = True
            # SQLite doesn't wait for every kind of lock.
            time.sleep(OPTIONS.retry_s)


@contextmanager
def _locks_translated() -> Iterator[None]:
    """Turn the error for a lock that another program holds, or a transaction of it, into `DatabaseBusyError`, and those
    for a disk that can't be used into `StorageError`."""
    try:
        yield
    except (DBAPIError, sqlite3.DatabaseError) as error:
        # The hook that configures a new connection raises the driver's own error.
        cause = error.orig if isinstance(error, DBAPIError) else error
        sentence = SENTENCES.get(str(getattr(cause, "sqlstate", None)))
        code = (getattr(cause, "sqlite_errorcode", None) or 0) & 0xFF
        if code in SQLITE_LOCK_CODES:
            sentence = LOCKED
        if sentence is not None:
            raise DatabaseBusyError(sentence) from error
        if code in STORAGE_ERRORS:
            kind, sentence = STORAGE_ERRORS[code]
            raise kind(sentence) from error
        if code == sqlite3.SQLITE_ERROR and str(cause).startswith(MISSING_SCHEMA):
            raise DatabaseDamagedError(MALFORMED) from error
        raise


def hold_blobs(connection: Connection) -> None:
    """Prevent other processes from discarding blobs until the transaction of a `write` ends."""
    # On SQLite every write transaction does that.
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": BLOB_LOCK})


def notify(connection: Connection, channel: str) -> None:
    """Send a notice, where the database has them, to all that wait for it: once the transaction is committed."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_notify(:channel, '')"), {"channel": channel})


def now() -> datetime:
    """Return the present time, in UTC."""
    return datetime.now(UTC)


def as_utc(value: datetime | None) -> datetime | None:
    """Return a stored time with its zone, which SQLite drops."""
    return value.replace(tzinfo=UTC) if value is not None and value.tzinfo is None else value
