"""Backups: a copy of the database and of every blob that it refers to, made and restored while the server runs.

A backup is a data folder: a server can be started on it. Blobs that it has already are not copied again.
"""

from __future__ import annotations

import sqlite3
import uuid
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from app.errors import ConflictError, InvalidInputError, NotFoundError
from app.limits import limit
from app.storage.blobs import BlobStore
from app.storage.check import blob_fault, blob_uses
from app.storage.db import Database

DATABASE_NAME = "roomfix.db"
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BackupOptions:
    """How a backup follows a store that changes meanwhile."""

    max_snapshots: int = limit(
        5,
        "Copies of the database that are made until one refers only to blobs that are there.",
        chosen="By hand: a blob goes only when a build ends or something is deleted.",
    )


OPTIONS = BackupOptions()


@dataclass(frozen=True, slots=True)
class Copied:
    """How many blobs were copied, how many were there already, and which could not be read."""

    copied: int
    present: int
    faulty: list[str]


def make_backup(database: Database, blobs: BlobStore, folder: Path, progress: Progress) -> Copied:
    """Copy the database and its blobs to a folder, new or of an earlier backup.

    Raises `InvalidInputError` for a database other than SQLite, which has tools of its own for that.
    """
    source = sqlite_path(database)
    folder.mkdir(parents=True, exist_ok=True)
    target = BlobStore.open(None, folder, folder)
    partial = folder / f"{DATABASE_NAME}.{uuid.uuid4().hex}"
    try:
        for _ in range(OPTIONS.max_snapshots):
            _copy_database(source, partial)
            copied = _copy_blobs(blobs, target, _references(partial), progress)
            # What a build or an edit has removed since the copy, the next copy doesn't refer to.
            if not any(blob_fault(blobs, digest) == "is missing" for digest in copied.faulty):
                break
        partial.replace(folder / DATABASE_NAME)
    finally:
        partial.unlink(missing_ok=True)
    return copied


def restore_backup(
    folder: Path, database_path: Path, blobs: BlobStore, progress: Progress, *, replace: bool
) -> Copied:
    """Bring blobs back that are missing or damaged, and the database too where there is none or with `replace`.

    Without `replace` only blobs that the present database refers to are restored. The server may run: SQLite replaces
    the contents of the database in one transaction. Raises `NotFoundError` for a folder without a backup.
    """
    backup = folder / DATABASE_NAME
    if not backup.is_file():
        raise NotFoundError(f"{folder} holds no backup: there is no {DATABASE_NAME} in it.")
    source = BlobStore.open(None, folder, folder)
    if not database_path.exists() or replace:
        copied = _copy_blobs(source, blobs, _references(backup), progress)
        if copied.faulty:
            raise ConflictError(
                f"The backup itself lacks {len(copied.faulty)} blobs, or they are damaged; nothing was replaced. "
                f"The first is {copied.faulty[0]}."
            )
        database_path.parent.mkdir(parents=True, exist_ok=True)
        _copy_database(backup, database_path)
        return copied
    return _copy_blobs(source, blobs, _references(database_path), progress)


def sqlite_path(database: Database) -> Path:
    """Return the file of an SQLite database; raises `InvalidInputError` for another one."""
    prefix = "sqlite:///"
    if not database.url.startswith(prefix):
        raise InvalidInputError(
            "This command copies an SQLite database. Use pg_dump and the tools of your object store instead: the "
            "database first, then the blobs."
        )
    return Path(database.url.removeprefix(prefix))


def _copy_database(source: Path, target: Path) -> None:
    """Copy an SQLite database, as of one moment; a target that is there takes the contents in one transaction."""
    with closing(sqlite3.connect(source)) as reading, closing(sqlite3.connect(target)) as writing:
        reading.backup(writing)


def _references(path: Path) -> list[str]:
    database = Database(f"sqlite:///{path}")
    try:
        # A backup of an earlier release gets the tables of this one.
        database.migrate()
        with database.read() as connection:
            return sorted(blob_uses(connection))
    finally:
        database.close()


def _copy_blobs(source: BlobStore, target: BlobStore, digests: list[str], progress: Progress) -> Copied:
    copied, present, faulty = 0, 0, []
    for done, digest in enumerate(digests):
        progress(done, len(digests))
        if blob_fault(target, digest) is None:
            present += 1
        elif blob_fault(source, digest) is not None:
            faulty.append(digest)
        else:
            target.put_file(source.local_path(digest))
            copied += 1
    progress(len(digests), len(digests))
    return Copied(copied, present, faulty)
