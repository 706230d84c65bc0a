"""Locks and collisions of PostgreSQL: errors to act on, not failures. Needs its programs and the extra `postgresql`."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from app.errors import DatabaseBusyError
from app.storage import venues
from app.storage.db import Database

pytest.importorskip("psycopg", reason="the extra postgresql is not installed")
PG_CTL = shutil.which("pg_ctl")
# PostgreSQL refuses to run as root.
NOBODY = ["runuser", "-u", "nobody", "--"] if os.geteuid() == 0 else []
pytestmark = pytest.mark.skipif(PG_CTL is None, reason="PostgreSQL is not installed")


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """The URL of an empty database of a server of its own, reached by a socket."""
    # A socket's path has at most 107 characters, more than some temporary folders of tests leave.
    folder = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))
    folder.chmod(0o777)
    data = folder / "data"

    def run(*command: str) -> None:
        subprocess.run([*NOBODY, *command], check=True, capture_output=True, timeout=120)

    programs = Path(os.path.realpath(str(PG_CTL))).parent
    run(str(programs / "initdb"), "-D", str(data), "-U", "roomfix", "-A", "trust", "--no-sync")
    server = f"-k {folder} -c listen_addresses= -c fsync=off -c deadlock_timeout=50ms"
    run(str(PG_CTL), "-D", str(data), "-o", server, "-l", str(folder / "log"), "-w", "start")
    try:
        yield f"postgresql+psycopg://roomfix@/postgres?host={folder}"
    finally:
        run(str(PG_CTL), "-D", str(data), "-m", "immediate", "stop")
        shutil.rmtree(folder)


@pytest.fixture
def database(url: str) -> Iterator[Database]:
    """A migrated database with two venues."""
    opened = Database(url)
    opened.migrate()
    with opened.write() as connection:
        connection.execute(text("DELETE FROM venues"))
        for venue in ("a", "b"):
            venues.create_venue(connection, venue, venue)
    yield opened
    opened.close()


def rename(venue: str) -> str:
    return f"UPDATE venues SET name = name || 'x' WHERE id = '{venue}'"


def test_a_write_fails_while_another_transaction_holds_its_rows(database: Database) -> None:
    def write(wait_s: float) -> None:
        with database.write(wait_s) as connection:
            connection.execute(text(rename("a")))

    with database.engine.connect() as other:
        other.execute(text(rename("a")))
        with pytest.raises(DatabaseBusyError, match="Another program holds the lock"):
            write(0.05)
        other.rollback()
    write(0.05)


def test_a_patient_write_waits_for_the_rows(url: str, database: Database) -> None:
    patient = Database(url, is_patient=True)

    def write() -> None:
        with patient.write() as connection:
            connection.execute(text(rename("a")))

    writer = threading.Thread(target=write)
    with database.engine.connect() as other:
        other.execute(text(rename("a")))
        writer.start()
        writer.join(0.3)
        assert writer.is_alive()
        other.rollback()
    writer.join(30)
    with database.read() as connection:
        assert venues.get_venue(connection, "a").name == "ax"
    patient.close()


def test_of_two_transactions_in_a_deadlock_one_is_to_be_tried_again(database: Database) -> None:
    both = threading.Barrier(2, timeout=30)
    failed: list[str] = []

    def write(first: str, second: str) -> None:
        try:
            with database.write() as connection:
                connection.execute(text(rename(first)))
                both.wait()
                connection.execute(text(rename(second)))
        except DatabaseBusyError as error:
            failed.append(str(error))

    threads = [threading.Thread(target=write, args=order) for order in (("a", "b"), ("b", "a"))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert failed == ["Another transaction of the database was in the way of this one. Try again."]


def test_a_serialization_failure_is_to_be_tried_again(database: Database) -> None:
    def write() -> None:
        with database.write() as connection:
            connection.execute(text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"))
            connection.execute(text("SELECT * FROM venues"))
            with database.engine.begin() as other:
                other.execute(text(rename("a")))
            connection.execute(text(rename("a")))

    with pytest.raises(DatabaseBusyError, match="in the way of this one"):
        write()
