"""The blobs that the database refers to, and the removal of all others."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import Connection, select

from app.storage.blobs import BlobStore
from app.storage.builds import ENDED
from app.storage.db import Database
from app.storage.tables import builds, floors, keyframe_images, map_versions

# Longer than the longest upload: a blob is stored shortly before the row that refers to it is committed.
GRACE = timedelta(hours=6)


def referenced_blobs(connection: Connection) -> set[str]:
    """Return the SHA-256 of every blob that is still needed; an ended build doesn't need its archive."""
    columns = (
        select(floors.c.plan_blob).where(floors.c.plan_blob.is_not(None)),
        select(builds.c.archive_blob).where(builds.c.state.not_in(ENDED)),
        select(map_versions.c.artifact_blob),
        select(map_versions.c.index_blob),
        select(keyframe_images.c.color_blob),
        select(keyframe_images.c.depth_blob),
    )
    return {str(digest) for query in columns for digest in connection.execute(query).scalars()}


def sweep_blobs(database: Database, blobs: BlobStore, grace: timedelta = GRACE) -> int:
    """Delete blobs that nothing refers to and that are older than `grace`; return how many."""
    with database.read() as connection:
        referenced = referenced_blobs(connection)
    return blobs.sweep(referenced, grace)
