"""A recording that was sent as it is, without an archive around it."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

from app.errors import InvalidScanError
from app.importers.archives.archive_readers import MIB, ArchiveLimits
from app.importers.archives.zstd_files import MAGIC as ZSTD
from app.importers.archives.zstd_files import first_bytes

_HEAD_BYTES = 4096
_MCAP = b"\x89MCAP0\r\n"
# First bytes of a kind of recording -> the suffix that the importers know it by.
_MAGIC = (
    (b"#ROSBAG V", ".bag"),
    (_MCAP, ".mcap"),
    (b"\x1a\x45\xdf\xa3", ".mkv"),
)
_SQLITE = b"SQLite format 3\0"
_SENS_VERSION = (4).to_bytes(4, "little")
# A .sens file begins with its version and the length of its sensor's name.
_MAX_SENSOR_NAME = 256


def suffix_of_recording(path: Path) -> str | None:
    """Return the suffix of the recording that a file is by its contents, None for anything else."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    for magic, suffix in _MAGIC:
        if head.startswith(magic):
            return suffix
    if head[4:8] == b"ftyp" and head[8:12] not in (b"heic", b"heix", b"mif1", b"avif"):
        return ".mp4"
    if head.startswith(b"RIFF") and head[8:12] == b"AVI ":
        return ".avi"
    if head.startswith((_SQLITE, ZSTD)):
        return _suffix_of_database(path) if head.startswith(_SQLITE) else _suffix_of_packed(path)
    if head.startswith(_SENS_VERSION) and 0 < int.from_bytes(head[4:12], "little") <= _MAX_SENSOR_NAME:
        return ".sens"
    return None


def lone_recording(recording: Path, destination: Path, suffix: str, limits: ArchiveLimits) -> Path:
    """Place a recording in a folder that has nothing else and return the folder; raises `InvalidScanError` for size."""
    size = recording.stat().st_size
    largest = min(limits.max_recording_bytes, limits.max_total_bytes)
    if size > largest:
        raise InvalidScanError(f"The recording has {size / MIB:.0f} MB; the limit is {largest / MIB:.0f} MB.")
    destination.mkdir(parents=True, exist_ok=True)
    target = destination / f"recording{suffix}"
    try:
        os.link(recording, target)
    except OSError:
        shutil.copyfile(recording, target)
    return destination


def _suffix_of_packed(path: Path) -> str | None:
    """Return the suffix of a ROS 2 bag that was packed by zstd, None for anything else that was."""
    inner = first_bytes(path, len(_SQLITE))
    if inner.startswith(_MCAP):
        return ".mcap.zstd"
    return ".db3.zstd" if inner == _SQLITE else None


def _suffix_of_database(path: Path) -> str:
    """Return `.db3` for a ROS 2 bag and `.db` for any other database."""
    try:
        with closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        ) as connection:
            names = {
                row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            }
    except sqlite3.DatabaseError:
        return ".db"
    return ".db3" if {"topics", "messages"} <= names else ".db"
