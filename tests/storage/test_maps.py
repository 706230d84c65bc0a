"""Map versions: numbered in each venue, the newest one serves, and none changes when another is added."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy.exc import IntegrityError

from app.errors import ConflictError, NotFoundError
from app.storage.builds import claim_build, create_build, finish_build
from app.storage.check import blob_uses
from app.storage.db import Database
from app.storage.maps import (
    KeptFrame,
    KeyframeImages,
    MapVersion,
    active_version,
    add_left_out,
    delete_map,
    get_map,
    list_keyframe_images,
    list_left_out,
    list_maps,
    publish_map,
)
from app.storage.sweep import referenced_blobs, venue_blobs
from app.storage.venues import create_venue, get_venue, set_active_map

IMAGES = [KeyframeImages(f"color{i}", f"depth{i}") for i in range(3)]


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """A migrated database with the venues `one` and `two`."""
    opened = Database(f"sqlite:///{tmp_path / 'test.db'}")
    opened.migrate()
    with opened.write() as connection:
        create_venue(connection, "one", "One")
        create_venue(connection, "two", "Two")
    yield opened
    opened.close()


def publish(database: Database, venue: str, name: str, images: list[KeyframeImages] | None = None) -> int:
    with database.write() as connection:
        return publish_map(
            connection, venue, f"build {name}", f"map {name}", f"index {name}", {"name": name}, images or []
        )


def serving(database: Database, venue: str) -> int | None:
    with database.read() as connection:
        return get_venue(connection, venue).active_map_version


def test_versions_are_counted_in_each_venue_and_the_newest_serves(database: Database) -> None:
    assert [publish(database, "one", name) for name in "abc"] == [1, 2, 3]
    assert publish(database, "two", "d") == 1
    assert (serving(database, "one"), serving(database, "two")) == (3, 1)
    with database.read() as connection:
        assert [each.version for each in list_maps(connection, "one")] == [3, 2, 1]
        assert [each.artifact_blob for each in list_maps(connection, "two")] == ["map d"]
        assert list_maps(connection, "three") == []


def test_after_a_step_back_the_next_version_still_has_a_number_of_its_own(database: Database) -> None:
    for name in "ab":
        publish(database, "one", name)
    with database.write() as connection:
        set_active_map(connection, "one", 1)
    assert serving(database, "one") == 1
    assert publish(database, "one", "c") == 3
    assert serving(database, "one") == 3


def version_of(statistics: dict[str, object]) -> MapVersion:
    return MapVersion(
        venue_id="one",
        version=1,
        build_id=None,
        artifact_blob="",
        index_blob="",
        statistics=statistics,
        created_at=datetime.now(UTC),
    )


def versions(database: Database, venue: str) -> list[int]:
    with database.read() as connection:
        return [each.version for each in list_maps(connection, venue)]


def test_a_version_is_deleted_alone_and_never_while_it_serves(database: Database) -> None:
    for venue in ("one", "two"):
        for name in "abc":
            publish(database, venue, name)
    with database.write() as connection:
        delete_map(connection, "one", 2)
    assert (versions(database, "one"), versions(database, "two")) == ([3, 1], [3, 2, 1])
    for version, error in ((3, ConflictError), (2, NotFoundError)):
        with pytest.raises(error, match=f"{version}"), database.write() as connection:
            delete_map(connection, "one", version)
    assert versions(database, "one") == [3, 1]


def test_a_number_is_not_used_again_and_no_other_venue_counts(database: Database) -> None:
    with database.write() as connection:
        for venue, version in (("one", 7), ("two", 9)):
            build = create_build(connection, venue, {}, "0" * 64)
            claim_build(connection, "w", build)
            finish_build(connection, build, "succeeded", worker="w", map_version=version)
    assert publish(database, "one", "a") == 8


def test_the_version_that_serves_is_the_venue_s_own(database: Database) -> None:
    for name in "ab":
        publish(database, "one", name)
    publish(database, "two", "c")
    serving_now = [active_of(database, venue) for venue in ("one", "two")]
    assert [
        (each.venue_id, each.version, each.artifact_blob) for each in serving_now if each is not None
    ] == [
        ("one", 2, "map b"),
        ("two", 1, "map c"),
    ]
    with database.write() as connection:
        set_active_map(connection, "one", 1)
        create_venue(connection, "three", "Three")
    found = active_of(database, "one")
    assert found is not None
    assert found.artifact_blob == "map a"
    assert active_of(database, "three") is None
    with pytest.raises(NotFoundError):
        active_of(database, "four")


def active_of(database: Database, venue: str) -> MapVersion | None:
    with database.read() as connection:
        return active_version(connection, venue)


def test_a_version_is_what_was_published(database: Database) -> None:
    before = datetime.now(UTC)
    publish(database, "one", "a")
    publish(database, "two", "b")
    with database.read() as connection:
        found = get_map(connection, "one", 1)
    assert (found.venue_id, found.version, found.build_id) == ("one", 1, "build a")
    assert (found.artifact_blob, found.index_blob, found.statistics) == ("map a", "index a", {"name": "a"})
    assert before <= found.created_at <= datetime.now(UTC)


def test_a_version_that_is_not_there_is_named(database: Database) -> None:
    publish(database, "one", "a")
    with database.read() as connection:
        for venue, version in (("one", 2), ("two", 1), ("three", 1)):
            with pytest.raises(NotFoundError, match=f"'{venue}' has no map version {version}"):
                get_map(connection, venue, version)


def test_pictures_belong_to_a_version_in_the_order_of_its_keyframes(database: Database) -> None:
    publish(database, "one", "a", IMAGES)
    publish(database, "one", "b", IMAGES[:1])
    publish(database, "one", "c")
    publish(database, "two", "d", IMAGES[::-1])
    with database.read() as connection:
        kept = [list_keyframe_images(connection, "one", version) for version in (1, 2, 3)]
        assert kept == [IMAGES, IMAGES[:1], []]
        assert list_keyframe_images(connection, "two", 1) == IMAGES[::-1]


LEFT_OUT = [
    KeptFrame(reason=reason, name=f"rgb/{i}.png", time_s=time_s, picture_blob=f"small {i}")
    for i, (reason, time_s) in enumerate((("no_depth", None), ("no_depth", 2.5), ("blurred", 0.5)))
]


def test_frames_that_were_left_out_belong_to_a_version_and_keep_their_pictures(database: Database) -> None:
    for venue, frames in (("one", LEFT_OUT[:1]), ("one", LEFT_OUT), ("two", LEFT_OUT[2:])):
        version = publish(database, venue, "a")
        with database.write() as connection:
            add_left_out(connection, venue, version, frames)
    publish(database, "one", "b")
    with database.read() as connection:
        kept = [list_left_out(connection, "one", version) for version in (1, 2, 3)]
        assert kept == [LEFT_OUT[:1], LEFT_OUT, []]
        blobs = {"small 0", "small 1", "small 2"}
        assert referenced_blobs(connection) >= blobs
        assert venue_blobs(connection, "two") & blobs == {"small 2"}
        (use,) = blob_uses(connection)["small 1"]
        assert (use.by, use.repair) == (
            "picture of a frame left out of version 2 of venue one",
            "the map serves without it",
        )
    with database.write() as connection:
        delete_map(connection, "one", 2)
    with database.read() as connection:
        assert list_left_out(connection, "one", 2) == []
        assert referenced_blobs(connection) & blobs == {"small 0", "small 2"}


def test_a_map_that_can_not_be_published_changes_nothing(database: Database) -> None:
    publish(database, "one", "a")
    with pytest.raises(IntegrityError):
        publish(database, "one", "b", [KeyframeImages("color", None)])  # type: ignore[arg-type]
    assert serving(database, "one") == 1
    with database.read() as connection:
        assert len(list_maps(connection, "one")) == 1


@pytest.mark.parametrize(
    ("statistics", "z_up"),
    [
        ({}, False),
        ({"placement": {"source": "scan_frame"}}, False),
        ({"placement": {"source": "given"}}, True),
        ({"placement": {"source": "gravity"}}, True),
        ({"placement": {"source": "registered"}}, False),
        ({"placement": {"source": "registered", "z_up": True}}, True),
        ({"placement": {"source": "given", "z_up": False}}, False),
    ],
    ids=str,
)
def test_whether_z_points_up_is_stated_or_follows_from_the_placement(
    statistics: dict[str, object], z_up: bool
) -> None:
    assert version_of(statistics).z_up is z_up


@pytest.mark.parametrize(
    ("placement", "reason"),
    [
        ({"source": "given"}, None),
        ({"source": "given", "has_scale": True}, None),
        ({"source": "given", "has_scale": False}, "scale_unknown"),
        ({"source": "scan_frame"}, "up_unknown"),
        ({"source": "scan_frame", "has_scale": False}, "scale_unknown"),
    ],
    ids=str,
)
def test_a_map_without_up_or_scale_has_no_plan(placement: dict[str, object], reason: str | None) -> None:
    version = version_of({"placement": placement})
    assert version.plan_reason == reason
    assert version.has_scale is placement.get("has_scale", True)
