"""The database: real migrations, transactions that hold together, and what each aggregate promises."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import select, update
from sqlalchemy.exc import IntegrityError

from app.errors import ConflictError, DatabaseDamagedError, NotFoundError
from app.storage import builds, floors, leases, maps, venues
from app.storage.db import Database
from app.storage.tables import map_versions, metadata


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """A fresh database, migrated."""
    opened = Database(f"sqlite:///{tmp_path / 'test.db'}")
    opened.migrate()
    yield opened
    opened.close()


@pytest.fixture
def venue(database: Database) -> str:
    """A venue's id."""
    with database.write() as connection:
        return venues.create_venue(connection, "v", "V").id


def test_the_migrations_make_just_the_tables_of_the_code(database: Database) -> None:
    with database.read() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
    database.migrate()


def test_a_write_that_raises_changes_nothing(database: Database) -> None:
    def write_and_fail() -> None:
        with database.write() as connection:
            venues.create_venue(connection, "a", "A")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_and_fail()
    with database.read() as connection:
        assert venues.list_venues(connection) == []
    with database.write() as connection:
        venues.create_venue(connection, "a", "A")


def test_writers_take_turns(database: Database, venue: str) -> None:
    def rename(name: str) -> None:
        for i in range(20):
            with database.write() as connection:
                before = venues.get_venue(connection, venue).name
                venues.rename_venue(connection, venue, f"{before[:100]}{name}{i % 10}")

    threads = [threading.Thread(target=rename, args=(name,)) for name in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with database.read() as connection:
        # Had two of them read the same name, one's letters would be lost.
        assert len(venues.get_venue(connection, venue).name) == 102
        assert venues.get_venue(connection, venue).name.startswith("V")


def test_a_second_venue_of_an_id_is_a_conflict(database: Database, venue: str) -> None:
    def again() -> None:
        with database.write() as connection:
            venues.create_venue(connection, venue, "again")

    with pytest.raises(ConflictError):
        again()


def test_deleting_a_venue_takes_everything_of_it_along(database: Database, venue: str) -> None:
    with database.write() as connection:
        floors.put_floor(
            connection,
            venue,
            "0",
            name="0",
            level=0,
            z_min_m=0,
            z_max_m=3,
            plan_from_world=np.eye(4),
            plan_residual_m=None,
        )
        build = builds.create_build(connection, venue, {}, "a" * 64)
        images = [maps.KeyframeImages("c" * 64, "d" * 64)]
        version = maps.publish_map(connection, venue, build, "e" * 64, "f" * 64, {}, images)
        kept = maps.KeptFrame(reason="blurred", name="rgb/1.png", time_s=None, picture_blob="b" * 64)
        maps.add_left_out(connection, venue, version, [kept])
        venues.delete_venue(connection, venue)
    with database.read() as connection:
        for table in metadata.sorted_tables:
            assert connection.execute(select(table)).all() == []


def test_rows_of_a_venue_that_is_not_there_are_refused(database: Database) -> None:
    def orphan() -> None:
        with database.write() as connection:
            builds.create_build(connection, "nowhere", {}, "a" * 64)

    with pytest.raises(IntegrityError):
        orphan()


def test_versions_count_up_and_the_newest_serves(database: Database, venue: str) -> None:
    with database.write() as connection:
        for i in range(3):
            assert maps.publish_map(connection, venue, "b", "e" * 64, "f" * 64, {"i": i}, []) == i + 1
        assert venues.get_venue(connection, venue).active_map_version == 3
        venues.set_active_map(connection, venue, 1)
        assert [item.version for item in maps.list_maps(connection, venue)] == [3, 2, 1]
        assert maps.get_map(connection, venue, 2).statistics == {"i": 1}
        with pytest.raises(NotFoundError):
            maps.get_map(connection, venue, 4)
        assert len(connection.execute(select(map_versions)).all()) == 3


def test_builds_are_taken_in_order_and_once(database: Database, venue: str) -> None:
    with database.write() as connection:
        ids = [builds.create_build(connection, venue, {"n": n}, "a" * 64) for n in range(3)]
        taken = [builds.claim_build(connection) for _ in range(4)]
    assert [build and build.id for build in taken] == [*ids, None]
    assert all(build is None or (build.state, build.attempts) == ("running", 1) for build in taken)


def test_builds_are_taken_by_priority_then_kind_then_age(database: Database, venue: str) -> None:
    wanted: list[tuple[builds.Kind, int]] = [
        ("pictures", 0), ("scan", 0), ("recording", 0), ("scan", -1), ("pictures", 2), ("scan", 0),
    ]  # fmt: skip
    with database.write() as connection:
        ids = [
            builds.create_build(connection, venue, {}, "a" * 64, kind=kind, priority=priority)
            for kind, priority in wanted
        ]
        assert builds.count_queued(connection) == {"scan": 3, "recording": 1, "pictures": 2}
        # A worker takes none of another kind, whatever its priority.
        assert builds.claim_build(connection, kinds=()) is None
        first = builds.claim_build(connection, kinds=("recording",))
        taken = [builds.claim_build(connection) for _ in range(5)]
        assert builds.count_queued(connection) == dict.fromkeys(("scan", "recording", "pictures"), 0)
    assert first is not None
    assert (first.id, first.kind) == (ids[2], "recording")
    assert [build and ids.index(build.id) for build in taken] == [4, 1, 5, 0, 3]


def test_what_has_waited_long_is_passed_by_no_kind(database: Database, venue: str) -> None:
    with database.write() as connection:
        long = builds.create_build(connection, venue, {}, "a" * 64, kind="pictures")
        since = builds.now() - timedelta(seconds=builds.OPTIONS.patience_s + 1)
        connection.execute(update(builds.builds).values(created_at=since))
        scan = builds.create_build(connection, venue, {}, "a" * 64)
        urgent = builds.create_build(connection, venue, {}, "a" * 64, priority=1)
        taken = [builds.claim_build(connection) for _ in range(3)]
    assert [build and build.id for build in taken] == [urgent, long, scan]


def test_a_build_ends_once(database: Database, venue: str) -> None:
    with database.write() as connection:
        build = builds.create_build(connection, venue, {}, "a" * 64)
        with pytest.raises(ConflictError):
            builds.finish_build(connection, build, "failed")
        builds.claim_build(connection)
        assert builds.report_progress(connection, build, "describe", 1, 9) is False
        builds.finish_build(connection, build, "succeeded", report={"a": 1}, map_version=1)
        with pytest.raises(ConflictError):
            builds.finish_build(connection, build, "failed")
        with pytest.raises(ConflictError):
            builds.cancel_build(connection, build)
        # Who still reports is told to stop.
        assert builds.report_progress(connection, build, "describe", 2, 9) is True
        assert builds.get_build(connection, build).done == 1


def test_a_running_build_learns_that_it_is_cancelled(database: Database, venue: str) -> None:
    with database.write() as connection:
        build = builds.create_build(connection, venue, {}, "a" * 64)
        builds.claim_build(connection)
        assert builds.cancel_build(connection, build).state == "running"
        assert builds.report_progress(connection, build, "describe", 1, 9) is True


def test_builds_without_a_worker_are_queued_again_and_at_last_failed(database: Database, venue: str) -> None:
    with database.write() as connection:
        build = builds.create_build(connection, venue, {}, "a" * 64)
        for _ in range(builds.OPTIONS.max_attempts):
            builds.claim_build(connection, "w")
            (lease,) = leases.list_leases(connection)
            assert (lease.build_id, lease.worker) == (build, "w")
            taken = leases.take_back(connection, lease)
            assert taken is not None
            assert taken.worker is None
            # Once: whoever comes second finds nothing.
            assert leases.take_back(connection, lease) is None
            if taken.attempts < builds.OPTIONS.max_attempts:
                assert taken.state == "queued"
        assert (taken.state, taken.error_code) == ("failed", "worker_died")
        assert leases.list_leases(connection) == []


def test_a_build_belongs_to_its_worker_while_its_heart_beats(database: Database, venue: str) -> None:
    with database.write() as connection:
        build = builds.create_build(connection, venue, {}, "a" * 64)
        builds.claim_build(connection, "first")
        (lease,) = leases.list_leases(connection)
        assert leases.beat(connection, "other") == 0
        assert leases.beat(connection, "first") == 1
        # Who saw the lease before the beat doesn't get the build.
        assert leases.take_back(connection, lease) is None
        (lease,) = leases.list_leases(connection)
        assert leases.take_back(connection, lease) is not None
        again = builds.claim_build(connection, "second")
        assert again is not None
        assert again.attempts == 2
        # The first worker, should it wake up, is told to stop and can end nothing.
        assert builds.report_progress(connection, build, "store", 1, 9, "first") is True
        with pytest.raises(ConflictError):
            builds.finish_build(connection, build, "failed", worker="first")
        assert builds.report_progress(connection, build, "describe", 1, 9, "second") is False
        builds.finish_build(connection, build, "succeeded", worker="second", map_version=1)
        assert leases.beat(connection, "second") == 0


def test_a_build_that_is_handed_over_counts_no_attempt(database: Database, venue: str) -> None:
    with database.write() as connection:
        build = builds.create_build(connection, venue, {}, "a" * 64)
        builds.claim_build(connection, "old")
        assert leases.hand_over(connection, "new") == 0
        assert leases.hand_over(connection, "old") == 1
        queued = builds.get_build(connection, build)
        assert (queued.state, queued.attempts, queued.worker) == ("queued", 0, None)
        assert builds.claim_build(connection, "new", "0" * 32) is None
        taken = builds.claim_build(connection, "new", build)
        assert taken is not None
        assert (taken.attempts, taken.worker) == (1, "new")


@pytest.mark.parametrize("change", ["RENAME COLUMN name TO nome", "RENAME TO houses"])
def test_a_file_without_the_tables_of_the_migration_is_damaged(tmp_path: Path, change: str) -> None:
    path = tmp_path / "test.db"
    database = Database(f"sqlite:///{path}")
    database.migrate()
    with closing(sqlite3.connect(path)) as other:
        other.execute(f"ALTER TABLE venues {change}")
        other.commit()
    with pytest.raises(DatabaseDamagedError, match="restore"), database.read() as connection:
        venues.list_venues(connection)
    database.close()
