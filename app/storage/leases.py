"""Leases of builds: a running build belongs to the worker that its row names, as long as that worker's heart beats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, select, update

from app.storage.builds import BUILD_QUEUED, OPTIONS, Build, end_build, get_build
from app.storage.db import notify
from app.storage.tables import builds

RUNNING = builds.c.state == "running"
# A build that is to be taken up anew.
UNCLAIMED: dict[str, Any] = {
    "state": "queued",
    "stage": None,
    "done": 0,
    "total": 0,
    "worker": None,
}


@dataclass(frozen=True, slots=True)
class Lease:
    """Who runs a build, and how often that worker's heart has beaten in it. `worker` is None for a build that was
    started by a release without leases."""

    build_id: str
    worker: str | None
    heartbeat: int


def beat(connection: Connection, worker: str) -> int:
    """Count a heartbeat in all builds of a worker; return their number."""
    own = RUNNING & (builds.c.worker == worker)
    return connection.execute(update(builds).where(own).values(heartbeat=builds.c.heartbeat + 1)).rowcount


def list_leases(connection: Connection) -> list[Lease]:
    """Return the leases of all running builds."""
    query = select(builds.c.id, builds.c.worker, builds.c.heartbeat).where(RUNNING)
    return [Lease(row.id, row.worker, row.heartbeat) for row in connection.execute(query)]


def take_back(connection: Connection, lease: Lease) -> Build | None:
    """Queue a build again whose worker is dead, or end it when it was to be cancelled or has had all its attempts.

    Returns the build as it is then; None when the worker's heart has beaten meanwhile, or the build has ended.
    """
    here = _held(lease)
    row = connection.execute(
        select(builds.c.cancel_requested, builds.c.attempts, builds.c.stage).where(here).with_for_update()
    ).first()
    if row is None:
        return None
    if row.cancel_requested:
        end_build(connection, lease.build_id, "cancelled")
    elif row.attempts >= OPTIONS.max_attempts:
        message = f"The worker died {row.attempts} times in this build, last in stage {row.stage!r}."
        end_build(connection, lease.build_id, "failed", error_code="worker_died", error=message)
    else:
        connection.execute(update(builds).where(here).values(**UNCLAIMED))
        notify(connection, BUILD_QUEUED)
    return get_build(connection, lease.build_id)


def hand_over(connection: Connection, worker: str) -> int:
    """Queue the builds again of a worker that stops in good order, which counts as no attempt; return their number."""
    own = RUNNING & (builds.c.worker == worker)
    values = {**UNCLAIMED, "attempts": builds.c.attempts - 1}
    handed = connection.execute(update(builds).where(own).values(**values)).rowcount
    if handed:
        notify(connection, BUILD_QUEUED)
    return handed


def _held(lease: Lease) -> Any:
    owner = builds.c.worker.is_(None) if lease.worker is None else builds.c.worker == lease.worker
    return (builds.c.id == lease.build_id) & RUNNING & owner & (builds.c.heartbeat == lease.heartbeat)
