"""A check of everything that is stored: is each blob there that a row refers to, and is it what was stored?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import Connection, select, text

from app.errors import NotFoundError
from app.storage.blobs import BlobStore
from app.storage.builds import ENDED
from app.storage.db import Database
from app.storage.map_files import sha256_of
from app.storage.tables import (
    anchor_frames,
    builds,
    floors,
    keyframe_images,
    left_out_frames,
    map_versions,
    recording_frames,
    venues,
)

RESTORE = "`roomfix restore BACKUP` brings it back from a backup"


@dataclass(frozen=True, slots=True)
class Use:
    """Who refers to a blob, and how it can be repaired without a backup."""

    by: str
    repair: str


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong, and what repairs it. `blob` is None for a fault of the database itself."""

    what: str
    repair: str
    blob: str | None = None


@dataclass(frozen=True, slots=True)
class CheckedStore:
    """What a check found: faults, the number of blobs that were read, and of those that nothing refers to."""

    findings: list[Finding]
    checked: int
    unreferenced: int


def check_store(database: Database, blobs: BlobStore, progress: Callable[[int, int], None]) -> CheckedStore:
    """Return what is wrong with database and blobs. Changes nothing; the server may run meanwhile."""
    with database.read() as connection:
        findings = _database_findings(connection)
        uses = blob_uses(connection)
    for done, (digest, users) in enumerate(sorted(uses.items())):
        progress(done, len(uses))
        fault = blob_fault(blobs, digest)
        if fault is not None and _is_used(database, digest):
            by = "; ".join(sorted({use.by for use in users})[:5])
            repairs = dict.fromkeys([RESTORE, *(use.repair for use in users)])
            findings.append(Finding(f"Blob {digest} {fault}: {by}.", "; ".join(repairs) + ".", digest))
    progress(len(uses), len(uses))
    return CheckedStore(findings, len(uses), len(blobs.digests() - set(uses)))


def blob_fault(blobs: BlobStore, digest: str) -> str | None:
    """Return what is wrong with a blob, None for one that is as it was stored."""
    blobs.forget(digest)
    try:
        path = blobs.local_path(digest)
        return None if sha256_of(path) == digest else "is damaged"
    except (NotFoundError, FileNotFoundError):
        return "is missing"
    except OSError as error:
        return f"can't be read ({error.strerror})"


def _is_used(database: Database, digest: str) -> bool:
    """Whether a row refers to a blob still: what was deleted while it was looked for is no fault."""
    with database.read() as connection:
        return digest in blob_uses(connection)


def blob_uses(connection: Connection) -> dict[str, list[Use]]:
    """Return by SHA-256 who refers to each blob that is needed; a build that has ended doesn't need its archive."""
    uses: dict[str, list[Use]] = defaultdict(list)
    for row in connection.execute(select(map_versions)):
        repair = f"or activate another version of venue {row.venue_id}, or build its map again"
        for digest, part in ((row.artifact_blob, "map"), (row.index_blob, "index")):
            uses[digest].append(Use(f"{part} of version {row.version} of venue {row.venue_id}", repair))
    for row in connection.execute(select(keyframe_images)):
        use = Use(
            f"pictures of version {row.version} of venue {row.venue_id}",
            "the map serves without its pictures",
        )
        uses[row.color_blob].append(use)
        uses[row.depth_blob].append(use)
    for row in connection.execute(select(left_out_frames)):
        use = Use(
            f"picture of a frame left out of version {row.version} of venue {row.venue_id}",
            "the map serves without it",
        )
        uses[row.picture_blob].append(use)
    for row in connection.execute(select(floors).where(floors.c.plan_blob.is_not(None))):
        use = Use(f"plan of floor {row.id} of venue {row.venue_id}", "or upload the plan again")
        uses[row.plan_blob].append(use)
    for row in connection.execute(select(builds).where(builds.c.state.not_in(ENDED))):
        use = Use(f"archive of build {row.id}", "or cancel the build and upload the scan again")
        uses[row.archive_blob].append(use)
    for row in connection.execute(select(anchor_frames).where(anchor_frames.c.image_blob.is_not(None))):
        use = Use(f"picture of anchor {row.anchor_id}", "or send a new frame of the camera")
        uses[row.image_blob].append(use)
    for row in connection.execute(select(recording_frames)):
        use = Use(f"frame {row.number} of recording {row.recording_id}", "or record the place again")
        uses[row.picture_blob].append(use)
    return dict(uses)


def _database_findings(connection: Connection) -> list[Finding]:
    findings = []
    if connection.dialect.name == "sqlite":
        for line in connection.execute(text("PRAGMA integrity_check")).scalars():
            if line != "ok":
                repair = "`roomfix restore --replace BACKUP` brings the database back from a backup."
                findings.append(Finding(f"The database is damaged: {line}.", repair))
    versions = select(map_versions.c.venue_id, map_versions.c.version)
    known = {(row.venue_id, row.version) for row in connection.execute(versions)}
    for row in connection.execute(select(venues).where(venues.c.active_map_version.is_not(None))):
        if (row.id, row.active_map_version) not in known:
            what = f"Venue {row.id} is to be served by version {row.active_map_version}, which is not there."
            findings.append(Finding(what, "Activate one of its versions."))
    return findings
