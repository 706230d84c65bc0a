"""The worker process: takes builds from the queue, one at a time.

At most one worker runs for a data folder. So a worker that starts knows that every build marked as running has lost
its worker.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from dataclasses import dataclass

from app.jobs.handlers import handle_build, recover, sweep
from app.jobs.lock import WorkerLock
from app.limits import limit
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.settings import Settings
from app.storage.builds import claim_build

log = logging.getLogger("roomfix.worker")
LOCK_NAME = "worker.lock"
# The server writes a byte at a time; more of them mean the same.
PIPE_BYTES = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerOptions:
    """How often the worker checks for work."""

    poll_s: float = limit(
        2.0,
        "Time between two checks of the queue; the server of an embedded worker wakes it at once.",
        chosen="By hand: a build takes minutes, so a wait of seconds doesn't matter.",
    )
    sweep_interval_s: float = limit(
        3600.0,
        "Time between two sweeps of blobs and scratch files.",
        chosen="By hand: orphans are rare and harmless.",
    )


OPTIONS = WorkerOptions()


def run_worker(settings: Settings, wake: threading.Event, stop: threading.Event) -> None:
    """Run builds until `stop` is set; waits first until no other worker holds the data folder."""
    with WorkerLock(settings.data_dir / LOCK_NAME, stop) as held:
        if not held:
            return
        resources = Resources.open(settings, is_patient=True)
        try:
            _serve(resources, wake, stop)
        finally:
            resources.close()


def _serve(resources: Resources, wake: threading.Event, stop: threading.Event) -> None:
    library = MapLibrary(resources)
    recover(resources)
    swept = float("-inf")
    while not stop.is_set():
        wake.clear()
        with resources.database.write() as connection:
            build = claim_build(connection)
        if build is not None:
            log.info("build %s of venue %s starts", build.id, build.venue_id)
            handle_build(build, resources, library)
            continue
        if time.monotonic() - swept > OPTIONS.sweep_interval_s:
            swept = time.monotonic()
            sweep(resources)
        wake.wait(OPTIONS.poll_s)


def _follow_parent(wake: threading.Event) -> None:
    """Wake the worker at each line from the server; end the process at once when the pipe closes."""
    # Without the buffer of `sys.stdin`: this thread would hold its lock, and an interpreter that exits then aborts.
    while os.read(sys.stdin.fileno(), PIPE_BYTES):
        wake.set()
    os._exit(0)


def main() -> None:
    """Run as the embedded worker: standard input is the pipe from the server."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    wake, stop = threading.Event(), threading.Event()
    # A build can be interrupted anywhere without harm, so the process ends at once.
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow_parent, args=(wake,), daemon=True).start()
    run_worker(Settings(), wake, stop)


if __name__ == "__main__":
    main()
