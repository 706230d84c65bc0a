"""Recordings: scans that phones film in the browser, frame by frame."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from app.errors import ConflictError, NotFoundError
from app.storage.db import as_utc, now
from app.storage.tables import builds, recording_frames, recordings


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A recording; `build_id` is the newest build that was made of it."""

    id: str
    venue_id: str
    build_id: str | None
    created_at: datetime
    active_at: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredFrame:
    """A frame of a recording: its picture, its time, and down in the camera's axes where the phone knows it."""

    number: int
    picture_blob: str
    bytes: int
    time_s: float
    down: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class Stored:
    """How much of a recording is stored: frames, bytes, and the numbers below the largest one that are missing."""

    frames: int
    bytes: int
    missing: tuple[int, ...]


def create_recording(connection: Connection, venue_id: str) -> Recording:
    """Add a recording; raises `NotFoundError` for an unknown venue."""
    moment = now()
    values = {"id": uuid.uuid4().hex, "venue_id": venue_id, "created_at": moment, "active_at": moment}
    try:
        connection.execute(insert(recordings).values(**values))
    except IntegrityError:
        raise NotFoundError(f"There is no venue {venue_id!r}.") from None
    return get_recording(connection, str(values["id"]))


def get_recording(connection: Connection, recording_id: str) -> Recording:
    """Return a recording; raises `NotFoundError`."""
    row = connection.execute(select(recordings).where(recordings.c.id == recording_id)).first()
    if row is None:
        raise NotFoundError(f"There is no recording {recording_id!r}.")
    return Recording(
        id=row.id,
        venue_id=row.venue_id,
        build_id=row.build_id,
        created_at=as_utc(row.created_at) or now(),
        active_at=as_utc(row.active_at) or now(),
    )


def add_frame(connection: Connection, recording_id: str, frame: StoredFrame) -> None:
    """Store a frame; the same frame again changes nothing. Raises `ConflictError` for another frame of its number."""
    earlier = find_frame(connection, recording_id, frame.number)
    if earlier is not None:
        if earlier.picture_blob != frame.picture_blob:
            raise ConflictError(f"Frame {frame.number} is stored already, with another picture.")
        return
    connection.execute(
        insert(recording_frames).values(
            recording_id=recording_id,
            number=frame.number,
            picture_blob=frame.picture_blob,
            bytes=frame.bytes,
            time_s=frame.time_s,
            down=None if frame.down is None else list(frame.down),
        )
    )
    touch(connection, recording_id)


def touch(connection: Connection, recording_id: str, **values: Any) -> None:
    """Store that a recording is being worked on, and changed values of its row."""
    here = recordings.c.id == recording_id
    connection.execute(update(recordings).where(here).values(active_at=now(), **values))


def find_frame(connection: Connection, recording_id: str, number: int) -> StoredFrame | None:
    """Return a frame, None where it is not stored."""
    here = (recording_frames.c.recording_id == recording_id) & (recording_frames.c.number == number)
    row = connection.execute(select(recording_frames).where(here)).first()
    return None if row is None else _frame(row)


def list_frames(connection: Connection, recording_id: str) -> Sequence[StoredFrame]:
    """Return the frames by their numbers."""
    return list(_frames(connection, recording_id))


def stored(connection: Connection, recording_id: str) -> Stored:
    """Return how much of a recording is stored."""
    here = recording_frames.c.recording_id == recording_id
    numbers = set(connection.execute(select(recording_frames.c.number).where(here)).scalars())
    total = connection.execute(select(func.coalesce(func.sum(recording_frames.c.bytes), 0)).where(here))
    missing = tuple(sorted(set(range(max(numbers, default=-1))) - numbers))
    return Stored(len(numbers), int(total.scalar_one()), missing)


def delete_recording(connection: Connection, recording_id: str) -> list[str]:
    """Delete a recording with its frames; return the blobs that it referred to. Raises `NotFoundError`."""
    get_recording(connection, recording_id)
    blobs = delete_frames(connection, recording_id)
    connection.execute(delete(recordings).where(recordings.c.id == recording_id))
    return blobs


def delete_frames(connection: Connection, recording_id: str) -> list[str]:
    """Delete the frames of a recording; return their blobs."""
    blobs = [frame.picture_blob for frame in _frames(connection, recording_id)]
    connection.execute(delete(recording_frames).where(recording_frames.c.recording_id == recording_id))
    return blobs


def sweep_recordings(connection: Connection, idle_since: datetime) -> list[str]:
    """Delete recordings that nobody has worked on since a time, and the frames of those whose map is built.

    Returns the blobs that they referred to.
    """
    idle = select(recordings.c.id).where(recordings.c.active_at < idle_since)
    built = select(builds.c.id).where(builds.c.state == "succeeded")
    mapped = select(recordings.c.id).where(recordings.c.build_id.in_(built))
    blobs = [
        blob
        for found in connection.execute(idle).scalars().all()
        for blob in delete_recording(connection, str(found))
    ]
    return blobs + [
        blob
        for found in connection.execute(mapped).scalars().all()
        for blob in delete_frames(connection, str(found))
    ]


def _frames(connection: Connection, recording_id: str) -> Iterator[StoredFrame]:
    query = select(recording_frames).where(recording_frames.c.recording_id == recording_id)
    for row in connection.execute(query.order_by(recording_frames.c.number)):
        yield _frame(row)


def _frame(row: Row[tuple[Any, ...]]) -> StoredFrame:
    down = None if row.down is None else (float(row.down[0]), float(row.down[1]), float(row.down[2]))
    return StoredFrame(
        number=row.number, picture_blob=row.picture_blob, bytes=row.bytes, time_s=row.time_s, down=down
    )
