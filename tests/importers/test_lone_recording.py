"""Recordings that are sent without an archive around them."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from app.errors import InvalidScanError
from app.importers.archives.archive import extract_archive
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.archives.lone_recording import suffix_of_recording

MIB = 1024 * 1024


def test_a_recording_by_itself_becomes_the_scan(tmp_path: Path) -> None:
    recording = tmp_path / "upload"
    recording.write_bytes(b"#ROSBAG V2.0\n" + bytes(2 * MIB))
    root = extract_archive(recording, tmp_path / "out")
    assert [path.name for path in root.iterdir()] == ["recording.bag"]
    assert (root / "recording.bag").read_bytes() == recording.read_bytes()
    with pytest.raises(InvalidScanError, match=r"has 2 MB; the limit is 1 MB"):
        extract_archive(recording, tmp_path / "other", ArchiveLimits(max_recording_bytes=MIB))


@pytest.mark.parametrize(
    ("head", "suffix"),
    [
        (b"#ROSBAG V2.0\n", ".bag"),
        (b"\x89MCAP0\r\n", ".mcap"),
        (b"\0\0\0\x20ftypisom", ".mp4"),
        (b"\0\0\0\x20ftypheic", None),
        (b"\x04\0\0\0\x0f\0\0\0\0\0\0\0StructureSensor", ".sens"),
        (b"PK\x03\x04", None),
        (b"", None),
    ],
)
def test_recordings_are_known_by_their_first_bytes(tmp_path: Path, head: bytes, suffix: str | None) -> None:
    (tmp_path / "upload").write_bytes(head + bytes(600))
    assert suffix_of_recording(tmp_path / "upload") == suffix


@pytest.mark.parametrize(("tables", "suffix"), [(("topics", "messages"), ".db3"), (("Node", "Data"), ".db")])
def test_databases_are_known_by_their_tables(tmp_path: Path, tables: tuple[str, ...], suffix: str) -> None:
    with sqlite3.connect(tmp_path / "upload") as connection:
        for table in tables:
            connection.execute(f"CREATE TABLE {table} (id INTEGER)")
    connection.close()
    assert suffix_of_recording(tmp_path / "upload") == suffix
