"""Builds: the queue, what runs, and how it ended."""

from __future__ import annotations

import re
import uuid
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from sqlalchemy import Connection, Row, insert, select, update

from app.errors import ConflictError, NotFoundError
from app.limits import limit
from app.storage.db import as_utc, now
from app.storage.tables import builds

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
ENDED = ("succeeded", "failed", "cancelled")
BUILD_ID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueOptions:
    """When a build is given up."""

    max_attempts: int = limit(
        3,
        "Times that a build is started; it fails when its worker died in the last of them.",
        chosen="By hand: a worker that was stopped twice is bad luck, one that dies three times dies of the build.",
    )


OPTIONS = QueueOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Build:
    """A build as it stands in the database."""

    id: str
    venue_id: str
    state: State
    stage: str | None
    done: int
    total: int
    options: dict[str, Any]
    archive_blob: str
    attempts: int
    cancel_requested: bool
    error_code: str | None
    error: str | None
    report: dict[str, Any] | None
    map_version: int | None
    created_at: datetime | None
    started_at: datetime | None
    finished_at: datetime | None

    @property
    def ended(self) -> bool:
        """Whether the build is over, so that its row doesn't change any more."""
        return self.state in ENDED


def create_build(
    connection: Connection,
    venue_id: str,
    options: dict[str, Any],
    archive_blob: str,
    idempotency_key: str | None = None,
) -> str:
    """Queue a build and return its id."""
    build_id = uuid.uuid4().hex
    connection.execute(
        insert(builds).values(
            id=build_id,
            venue_id=venue_id,
            state="queued",
            done=0,
            total=0,
            options=options,
            archive_blob=archive_blob,
            attempts=0,
            cancel_requested=False,
            created_at=now(),
            idempotency_key=idempotency_key,
        )
    )
    return build_id


def find_submission(connection: Connection, venue_id: str, idempotency_key: str | None) -> Build | None:
    """Return the build of a venue that was submitted with a key, None where there is none."""
    if idempotency_key is None:
        return None
    here = (builds.c.venue_id == venue_id) & (builds.c.idempotency_key == idempotency_key)
    row = connection.execute(select(builds).where(here)).first()
    return None if row is None else _build(row)


def get_build(connection: Connection, build_id: str) -> Build:
    """Return a build; raises `NotFoundError`."""
    row = connection.execute(select(builds).where(builds.c.id == build_id)).first()
    if row is None:
        raise NotFoundError(f"There is no build {build_id!r}.")
    return _build(row)


def list_builds(connection: Connection, venue_id: str | None = None) -> list[Build]:
    """Return the builds of a venue, or all, newest first."""
    query = select(builds).order_by(builds.c.created_at.desc())
    if venue_id is not None:
        query = query.where(builds.c.venue_id == venue_id)
    return [_build(row) for row in connection.execute(query)]


def claim_build(connection: Connection) -> Build | None:
    """Take the oldest queued build and mark it as running, or return None."""
    query = select(builds.c.id).where(builds.c.state == "queued").order_by(builds.c.created_at).limit(1)
    build_id = connection.execute(query.with_for_update(skip_locked=True)).scalar()
    if build_id is None:
        return None
    connection.execute(
        update(builds)
        .where(builds.c.id == build_id)
        .values(state="running", stage="start", started_at=now(), attempts=builds.c.attempts + 1)
    )
    return get_build(connection, build_id)


def report_progress(connection: Connection, build_id: str, stage: str, done: int, total: int) -> bool:
    """Store how far a build is; return whether it should stop, since it was cancelled or its venue was deleted."""
    here = (builds.c.id == build_id) & (builds.c.state == "running")
    changed = connection.execute(update(builds).where(here).values(stage=stage, done=done, total=total))
    if changed.rowcount == 0:
        return True
    return bool(connection.execute(select(builds.c.cancel_requested).where(here)).scalar())


def finish_build(
    connection: Connection,
    build_id: str,
    state: State,
    *,
    report: dict[str, Any] | None = None,
    map_version: int | None = None,
    error_code: str | None = None,
    error: str | None = None,
) -> None:
    """Record how a running build ended; raises `ConflictError` when it doesn't run any more."""
    here = (builds.c.id == build_id) & (builds.c.state == "running")
    changed = connection.execute(
        update(builds)
        .where(here)
        .values(
            state=state,
            report=report,
            map_version=map_version,
            error_code=error_code,
            error=error,
            finished_at=now(),
        )
    )
    if changed.rowcount == 0:
        raise ConflictError(f"Build {build_id} is not running.")


def cancel_build(connection: Connection, build_id: str) -> Build:
    """Cancel a build: at once while it is queued, else at its next report; raises `ConflictError` if it has ended."""
    build = get_build(connection, build_id)
    if build.ended:
        raise ConflictError(f"Build {build_id} has {build.state} already.")
    queued = (builds.c.id == build_id) & (builds.c.state == "queued")
    connection.execute(update(builds).where(queued).values(state="cancelled", finished_at=now()))
    connection.execute(update(builds).where(builds.c.id == build_id).values(cancel_requested=True))
    return get_build(connection, build_id)


def recover_builds(connection: Connection) -> tuple[list[Build], list[Build]]:
    """Queue the builds again whose worker died, and end those that were to be cancelled or have had all their attempts.

    Returns the builds queued again and the builds ended. To be called only by a worker that knows that no other one is
    alive.
    """
    requeued, ended = [], []
    for row in connection.execute(select(builds).where(builds.c.state == "running")).all():
        build = _build(row)
        if build.cancel_requested:
            finish_build(connection, build.id, "cancelled")
            ended.append(get_build(connection, build.id))
        elif build.attempts >= OPTIONS.max_attempts:
            message = f"The worker died {build.attempts} times in this build, last in stage {build.stage!r}."
            finish_build(connection, build.id, "failed", error_code="worker_died", error=message)
            ended.append(get_build(connection, build.id))
        else:
            values = {"state": "queued", "stage": None, "done": 0, "total": 0}
            connection.execute(update(builds).where(builds.c.id == build.id).values(**values))
            requeued.append(get_build(connection, build.id))
    return requeued, ended


def _build(row: Row[tuple[Any, ...]]) -> Build:
    values = {name: getattr(row, name) for name in Build.__slots__}
    for name in ("created_at", "started_at", "finished_at"):
        values[name] = as_utc(values[name])
    return Build(**values)
