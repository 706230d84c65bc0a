"""Leases as a worker keeps and watches them: its own heart beats, and it sees when another one has stopped."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from app.errors import DatabaseBusyError
from app.jobs.worker_name import is_surely_dead
from app.limits import limit
from app.storage.db import Database
from app.storage.leases import Lease, beat

log = logging.getLogger("roomfix.jobs")


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseOptions:
    """When a worker counts as dead."""

    heartbeat_s: float = limit(
        2.0,
        "Time between two heartbeats of a worker.",
        chosen="By hand: a small write, and several in a lease.",
    )
    lease_s: float = limit(
        20.0,
        "Time without a heartbeat after which a build is taken from its worker. A process of the same machine that has "
        "ended counts as dead at once.",
        chosen="By hand: ten heartbeats, longer than a busy machine holds a process up.",
    )
    max_step_s: float = limit(
        4.0,
        "Most time that counts between two looks at the heartbeats.",
        chosen="By hand: twice the time between two looks. While the database was locked, or the machine slept, no "
        "heart could beat.",
    )


OPTIONS = LeaseOptions()


class Heart:
    """A thread that counts a worker's heartbeats in its builds, until the process ends or `stop` is called."""

    def __init__(self, database: Database, worker: str) -> None:
        self._database, self._worker = database, worker
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def start(self) -> None:
        """Start to beat."""
        self._thread.start()

    def stop(self) -> None:
        """Stop; returns when no beat is being written."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(OPTIONS.heartbeat_s):
            try:
                with self._database.write() as connection:
                    beat(connection, self._worker)
            except DatabaseBusyError:
                continue
            except Exception:
                # The next one may succeed; without any the build goes to another worker.
                log.exception("a heartbeat could not be written")


class LeaseWatch:
    """Sees which leases have run out, by this process's own clock: clocks of other machines don't count."""

    def __init__(self) -> None:
        self._silent_s: dict[Lease, float] = {}
        self._looked: float | None = None

    def run_out(self, leases: list[Lease]) -> list[Lease]:
        """Return those of the present leases whose worker is dead."""
        now = time.monotonic()
        step_s = 0.0 if self._looked is None else min(now - self._looked, OPTIONS.max_step_s)
        self._looked = now
        # A lease with a new heartbeat is another value, and starts anew.
        self._silent_s = {
            lease: self._silent_s[lease] + step_s if lease in self._silent_s else 0.0 for lease in leases
        }
        return [
            lease
            for lease, silent_s in self._silent_s.items()
            if lease.worker is None or silent_s > OPTIONS.lease_s or is_surely_dead(lease.worker)
        ]
