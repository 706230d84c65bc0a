"""Builds: the queue, what runs, and how it ended."""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal

from sqlalchemy import ColumnElement, Connection, Row, case, func, insert, select, update

from app.build_kinds import KINDS, Kind
from app.errors import ConflictError, NotFoundError
from app.limits import limit
from app.storage.db import as_utc, notify, now
from app.storage.tables import builds

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
ENDED = ("succeeded", "failed", "cancelled")
QUEUED = builds.c.state == "queued"
# The notice that a build was queued.
BUILD_QUEUED = "roomfix_build_queued"


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueOptions:
    """When a build is begun, and when it is given up."""

    max_attempts: int = limit(
        3,
        "Times that a build is started; it fails when its worker died in the last of them.",
        chosen="By hand: a worker that was stopped twice is bad luck, one that dies three times dies of the build.",
    )
    patience_s: float = limit(
        1800.0,
        "Time after which a queued build is no longer passed by builds of another kind that came later.",
        chosen="By hand: as long as a large video takes; without it a busy server would never build one.",
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
    kind: Kind
    priority: int
    attempts: int
    worker: str | None
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
    *,
    kind: Kind = "scan",
    priority: int = 0,
) -> str:
    """Queue a build and return its id; of two builds the one with the higher priority is begun first."""
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
            kind=kind,
            priority=priority,
            attempts=0,
            cancel_requested=False,
            created_at=now(),
            idempotency_key=idempotency_key,
        )
    )
    notify(connection, BUILD_QUEUED)
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


def count_builds(connection: Connection) -> dict[tuple[str, str], int]:
    """Return the number of builds by state and stage; only a running build has a stage here."""
    query = select(builds.c.state, builds.c.stage, func.count()).group_by(builds.c.state, builds.c.stage)
    counts: Counter[tuple[str, str]] = Counter()
    for state, stage, count in connection.execute(query):
        counts[state, (stage or "") if state == "running" else ""] += count
    return dict(counts)


def count_queued(connection: Connection) -> dict[Kind, int]:
    """Return the number of builds of each kind that wait for a worker."""
    query = select(builds.c.kind, func.count().label("number")).where(QUEUED).group_by(builds.c.kind)
    found = {row.kind: int(row.number) for row in connection.execute(query)}
    return {kind: found.get(kind, 0) for kind in KINDS}


def claim_build(
    connection: Connection, worker: str = "", build_id: str | None = None, kinds: Sequence[Kind] = KINDS
) -> Build | None:
    """Take the first queued build of some kinds, or the given one if it is queued, for a worker; None without one.

    The first is that of the highest priority, then of the first kind of `KINDS`, then the oldest. What has waited for
    `OPTIONS.patience_s` goes before all kinds.
    """
    query = select(builds.c.id).where(QUEUED & builds.c.kind.in_(kinds))
    query = query.order_by(builds.c.priority.desc(), _turn(), builds.c.created_at).limit(1)
    if build_id is not None:
        query = query.where(builds.c.id == build_id)
    found = connection.execute(query.with_for_update(skip_locked=True)).scalar()
    if found is None:
        return None
    connection.execute(
        update(builds)
        .where(builds.c.id == found)
        .values(
            state="running",
            stage="start",
            started_at=now(),
            attempts=builds.c.attempts + 1,
            worker=worker,
            heartbeat=builds.c.heartbeat + 1,
        )
    )
    return get_build(connection, found)


def _turn() -> ColumnElement[int]:
    """Return the number by which builds of one priority are ordered: 0 for what has waited long, then the kinds."""
    overdue = builds.c.created_at < now() - timedelta(seconds=OPTIONS.patience_s)
    by_kind = {kind: number for number, kind in enumerate(KINDS, start=1)}
    return case((overdue, 0), *((builds.c.kind == kind, number) for kind, number in by_kind.items()), else_=1)


def report_progress(
    connection: Connection, build_id: str, stage: str, done: int, total: int, worker: str = ""
) -> bool:
    """Store how far a worker's build is; return whether it should stop: it was cancelled, its venue was deleted, or it
    belongs to another worker by now."""
    here = _of_worker(build_id, worker)
    changed = connection.execute(update(builds).where(here).values(stage=stage, done=done, total=total))
    if changed.rowcount == 0:
        return True
    return bool(connection.execute(select(builds.c.cancel_requested).where(here)).scalar())


def finish_build(
    connection: Connection, build_id: str, state: State, *, worker: str = "", **values: Any
) -> None:
    """Record how a worker's build ended, with the values of `end_build`.

    Raises `ConflictError` when it doesn't run any more, or belongs to another worker by now.
    """
    if (
        connection.execute(select(builds.c.id).where(_of_worker(build_id, worker)).with_for_update()).first()
        is None
    ):
        raise ConflictError(f"Build {build_id} is not running.")
    end_build(connection, build_id, state, **values)


def end_build(
    connection: Connection,
    build_id: str,
    state: State,
    *,
    report: dict[str, Any] | None = None,
    map_version: int | None = None,
    error_code: str | None = None,
    error: str | None = None,
) -> None:
    """Record how a build ended, whoever ran it."""
    connection.execute(
        update(builds)
        .where(builds.c.id == build_id)
        .values(
            state=state,
            report=report,
            map_version=map_version,
            error_code=error_code,
            error=error,
            worker=None,
            finished_at=now(),
        )
    )


def _of_worker(build_id: str, worker: str) -> Any:
    return (builds.c.id == build_id) & (builds.c.state == "running") & (builds.c.worker == worker)


def cancel_build(connection: Connection, build_id: str) -> Build:
    """Cancel a build: at once while it is queued, else at its next report; raises `ConflictError` if it has ended."""
    build = get_build(connection, build_id)
    if build.ended:
        raise ConflictError(f"Build {build_id} has {build.state} already.")
    queued = (builds.c.id == build_id) & QUEUED
    connection.execute(update(builds).where(queued).values(state="cancelled", finished_at=now()))
    connection.execute(update(builds).where(builds.c.id == build_id).values(cancel_requested=True))
    return get_build(connection, build_id)


def _build(row: Row[tuple[Any, ...]]) -> Build:
    values = {name: getattr(row, name) for name in Build.__slots__}
    for name in ("created_at", "started_at", "finished_at"):
        values[name] = as_utc(values[name])
    return Build(**values)
