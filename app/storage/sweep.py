"""Removes blobs that the database doesn't refer to, and old scratch files."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Set
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from sqlalchemy import Connection, select

from app.limits import limit
from app.storage.blobs import BlobStore
from app.storage.builds import ENDED
from app.storage.db import Database, hold_blobs, now
from app.storage.tables import (
    anchor_frames,
    anchors,
    builds,
    floors,
    keyframe_images,
    left_out_frames,
    map_versions,
    recording_frames,
    recordings,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """What the sweep leaves alone."""

    grace_h: float = limit(
        6.0,
        "Blobs and scratch files younger than this are kept even when nothing refers to them.",
        chosen="By hand: longer than the longest build, which stores its images some time before the rows that refer "
        "to them.",
    )


OPTIONS = SweepOptions()
GRACE = timedelta(hours=OPTIONS.grace_h)


def referenced_blobs(connection: Connection) -> set[str]:
    """Return the SHA-256 of every blob that is needed; a build that has ended doesn't need its archive."""
    columns = (
        select(floors.c.plan_blob).where(floors.c.plan_blob.is_not(None)),
        select(floors.c.plan_tiles_blob).where(floors.c.plan_tiles_blob.is_not(None)),
        select(builds.c.archive_blob).where(builds.c.state.not_in(ENDED)),
        select(map_versions.c.artifact_blob),
        select(map_versions.c.index_blob),
        select(keyframe_images.c.color_blob),
        select(keyframe_images.c.depth_blob),
        select(left_out_frames.c.picture_blob),
        select(anchor_frames.c.image_blob).where(anchor_frames.c.image_blob.is_not(None)),
        select(recording_frames.c.picture_blob),
    )
    return {str(digest) for query in columns for digest in connection.execute(query).scalars()}


def venue_blobs(connection: Connection, venue_id: str) -> set[str]:
    """Return the SHA-256 of every blob that a venue's rows refer to, the archives of ended builds among them."""
    columns = (
        select(floors.c.plan_blob).where((floors.c.venue_id == venue_id) & floors.c.plan_blob.is_not(None)),
        select(floors.c.plan_tiles_blob).where(
            (floors.c.venue_id == venue_id) & floors.c.plan_tiles_blob.is_not(None)
        ),
        select(builds.c.archive_blob).where(builds.c.venue_id == venue_id),
        select(map_versions.c.artifact_blob).where(map_versions.c.venue_id == venue_id),
        select(map_versions.c.index_blob).where(map_versions.c.venue_id == venue_id),
        select(keyframe_images.c.color_blob).where(keyframe_images.c.venue_id == venue_id),
        select(keyframe_images.c.depth_blob).where(keyframe_images.c.venue_id == venue_id),
        select(left_out_frames.c.picture_blob).where(left_out_frames.c.venue_id == venue_id),
        select(anchor_frames.c.image_blob)
        .join(anchors, anchors.c.id == anchor_frames.c.anchor_id)
        .where((anchors.c.venue_id == venue_id) & anchor_frames.c.image_blob.is_not(None)),
        select(recording_frames.c.picture_blob)
        .join(recordings, recordings.c.id == recording_frames.c.recording_id)
        .where(recordings.c.venue_id == venue_id),
    )
    return {str(digest) for query in columns for digest in connection.execute(query).scalars()}


def discard_blobs(
    database: Database, blobs: BlobStore, digests: Iterable[str], written_by: str | None = None
) -> int:
    """Delete those of the blobs that nothing refers to; return their number.

    `written_by` is the build that stored them. Nothing is deleted while another build runs, which may have stored the
    same images without having published them yet.

    A writer of a row that refers to a blob must check in its transaction, after `hold_blobs`, that the blob exists, and
    store it again if not. So a blob that was stored before its row is safe.
    """
    with database.write() as connection:
        hold_blobs(connection)
        if written_by is not None and _others_run(connection, written_by):
            return 0
        unneeded = set(digests) - referenced_blobs(connection)
        blobs.delete(unneeded)
    return len(unneeded)


def _others_run(connection: Connection, build_id: str) -> bool:
    others = select(builds.c.id).where((builds.c.state == "running") & (builds.c.id != build_id))
    return connection.execute(others.limit(1)).first() is not None


def sweep_scratch(folder: Path, age: timedelta, running: Set[str] = frozenset()) -> int:
    """Delete what killed processes left in the scratch folder and is older than `age`; return the number of entries.

    Folders of the builds `running` are kept.
    """
    limit = (now() - age).timestamp()
    count = 0
    for path in folder.iterdir():
        # An upload may end, and remove its file, at any moment.
        with suppress(FileNotFoundError):
            if path.stat().st_mtime > limit or path.name.split("-")[0] in running:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
            count += 1
    return count


def sweep_blobs(database: Database, blobs: BlobStore, grace: timedelta = GRACE) -> int:
    """Delete blobs that nothing refers to and that are older than `grace`; return their number."""
    return discard_blobs(database, blobs, blobs.older_than(grace)) + blobs.sweep_staging(grace)
