"""A database that another program has locked: transactions fail with an error to act on, or wait for it."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from app.errors import BusyError, DatabaseBusyError
from app.storage import db, venues
from app.storage.db import OPTIONS, Database
from tests.locks import locked


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a migrated database."""
    path = tmp_path / "test.db"
    database = Database(f"sqlite:///{path}")
    database.migrate()
    database.close()
    return path


@contextmanager
def opened(path: Path, *, is_patient: bool = False) -> Iterator[Database]:
    database = Database(f"sqlite:///{path}", is_patient=is_patient)
    yield database
    database.close()


def add_venue(database: Database, venue: str, wait_s: float | None = None) -> None:
    with database.write(wait_s) as connection:
        venues.create_venue(connection, venue, venue)


def names(database: Database) -> list[str]:
    with database.read() as connection:
        return [venue.id for venue in venues.list_venues(connection)]


@pytest.mark.parametrize("mode", ["IMMEDIATE", "EXCLUSIVE"])
def test_a_write_fails_while_the_lock_is_held_and_reads_go_on(path: Path, mode: str) -> None:
    with opened(path) as database:
        add_venue(database, "before")
        with locked(path, mode):
            with pytest.raises(DatabaseBusyError, match="Another program holds the lock"):
                add_venue(database, "during", 0.05)
            assert names(database) == ["before"]
        add_venue(database, "after", 0.05)
        assert names(database) == ["after", "before"]
    assert issubclass(DatabaseBusyError, BusyError)


def test_a_time_to_wait_holds_for_one_transaction(path: Path) -> None:
    def wait_ms(database: Database) -> int:
        with database.read() as connection:
            return int(connection.execute(text("PRAGMA busy_timeout")).scalar_one())

    with opened(path) as database:
        assert wait_ms(database) == 1000 * OPTIONS.lock_wait_s
        with locked(path), pytest.raises(DatabaseBusyError):
            add_venue(database, "a", 0.01)
        add_venue(database, "a", 0.01)
        assert wait_ms(database) == 1000 * OPTIONS.lock_wait_s
    with opened(path, is_patient=True) as database:
        assert wait_ms(database) == 1000 * OPTIONS.patient_wait_s


def test_a_patient_write_waits_for_the_lock(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with opened(path, is_patient=True) as database:
        writer = threading.Thread(target=add_venue, args=(database, "late"))
        with locked(path):
            writer.start()
            # Longer than a single attempt takes.
            writer.join(2.5 * OPTIONS.patient_wait_s)
            assert writer.is_alive()
            assert names(database) == []
        writer.join(30)
        assert names(database) == ["late"]
    assert [record.message for record in caplog.records].count(
        "another program holds the lock of the database; waiting for it"
    ) == 1


def test_a_current_database_is_opened_while_it_is_locked(path: Path) -> None:
    with opened(path) as database, locked(path):
        database.migrate()
        assert names(database) == []


def test_new_tables_wait_for_the_lock(tmp_path: Path) -> None:
    path = tmp_path / "new.db"
    with opened(path) as database:
        # The first connection turns on the write-ahead log, without which a lock keeps readers out.
        database.ping()
        migration = threading.Thread(target=database.migrate)
        with locked(path):
            migration.start()
            migration.join(0.3)
            assert migration.is_alive()
        migration.join(60)
        assert names(database) == []


def test_a_program_that_keeps_readers_out_is_named_too(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(db, "OPTIONS", db.DatabaseOptions(lock_wait_s=0.05, patient_wait_s=0.05))
    # Without the write-ahead log, as on some network drives, an exclusive lock keeps readers out.
    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    assert other.execute("PRAGMA journal_mode = DELETE").fetchone() == ("delete",)
    other.execute("BEGIN EXCLUSIVE")
    found: list[list[str]] = []
    try:
        with opened(path) as database, pytest.raises(DatabaseBusyError):
            names(database)
        with opened(path, is_patient=True) as patient:
            reader = threading.Thread(target=lambda: found.append(names(patient)))
            reader.start()
            reader.join(0.3)
            assert reader.is_alive()
            other.rollback()
            reader.join(30)
    finally:
        other.rollback()
        other.close()
    assert found == [[]]


def test_other_errors_of_the_database_stay_what_they_are(path: Path) -> None:
    with opened(path) as database:

        def fail() -> None:
            with database.write() as connection:
                connection.execute(text("INSERT INTO venues VALUES (1)"))

        with pytest.raises(OperationalError, match="1 values"):
            fail()
