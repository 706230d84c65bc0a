"""The worker process: takes builds from the queue, one at a time.

Any number of workers share a database. A build belongs to the worker that its row names while that one's heart beats.
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
from app.jobs.lease import Heart, LeaseWatch
from app.jobs.news import News
from app.jobs.sharing import Helper
from app.jobs.worker_name import worker_name
from app.limits import limit
from app.logs import configure_logs, log_context
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.settings import Settings
from app.storage.builds import claim_build
from app.storage.db import Database
from app.storage.leases import hand_over

log = logging.getLogger("roomfix.worker")
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
    hand_over_wait_s: float = limit(
        3.0,
        "Time that a worker that stops waits for the lock of the database, to hand its build over.",
        chosen="By hand: service managers wait longer; without it the build counts an attempt more.",
    )
    sweep_interval_s: float = limit(
        3600.0,
        "Time between two sweeps of blobs and scratch files.",
        chosen="By hand: orphans are rare and harmless.",
    )


OPTIONS = WorkerOptions()


def run_worker(settings: Settings, wake: threading.Event, stop: threading.Event) -> None:
    """Run builds until `stop` is set; a build that runs then is finished in the time that the settings leave, or handed
    over, and the process ends."""
    resources = Resources.open(settings, is_patient=True)
    worker = worker_name()
    heart = Heart(resources.database, worker)
    heart.start()
    news = News(resources.database, wake)
    news.start()
    idle = threading.Event()
    ending = threading.Thread(target=_end_when_stopped, args=(settings, worker, stop, idle), daemon=True)
    ending.start()
    try:
        _serve(resources, worker, wake, stop)
    finally:
        idle.set()
        heart.stop()
        news.stop()
        resources.close()


def _serve(resources: Resources, worker: str, wake: threading.Event, stop: threading.Event) -> None:
    library, watch, kinds = MapLibrary(resources), LeaseWatch(), resources.settings.kinds_of_builds
    helper = Helper(resources, library, stop)
    swept = float("-inf")
    while not stop.is_set():
        wake.clear()
        recover(resources, watch)
        with resources.database.write() as connection:
            build = None if stop.is_set() else claim_build(connection, worker, kinds=kinds)
        if build is not None:
            with log_context(build=build.id):
                log.info("build %s of venue %s starts", build.id, build.venue_id)
                handle_build(build, resources, library)
            continue
        if helper.help_one():
            continue
        if time.monotonic() - swept > OPTIONS.sweep_interval_s:
            swept = time.monotonic()
            sweep(resources)
        helper.wait(wake, OPTIONS.poll_s)


def _end_when_stopped(settings: Settings, worker: str, stop: threading.Event, idle: threading.Event) -> None:
    """Wait for `stop` and the time to finish, hand a build that still runs over to the next worker, and end the
    process."""
    stop.wait()
    if not idle.wait(settings.finish_build_s):
        log.info("the build did not end in %g s", settings.finish_build_s)
    # Not through the patient database of the worker: a lock that another program holds must not keep the process.
    database = Database(settings.resolved_database_url)
    try:
        with database.write(OPTIONS.hand_over_wait_s) as connection:
            if hand_over(connection, worker):
                log.info("the running build is handed over")
    except Exception:
        log.exception("the running build could not be handed over; the next worker finds it")
    os._exit(0)


def _follow_parent(wake: threading.Event, stop: threading.Event) -> None:
    """Wake the worker at each line from the server; stop it when the pipe closes."""
    # Without the buffer of `sys.stdin`: this thread would hold its lock, and an interpreter that exits then aborts.
    while os.read(sys.stdin.fileno(), PIPE_BYTES):
        wake.set()
    stop.set()


def main() -> None:
    """Run as the embedded worker: standard input is the pipe from the server."""
    settings = Settings()
    configure_logs(settings.log_level, settings.log_format)
    wake, stop = threading.Event(), threading.Event()
    # A build can be interrupted anywhere without harm.
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow_parent, args=(wake, stop), daemon=True).start()
    run_worker(settings, wake, stop)


if __name__ == "__main__":
    main()
