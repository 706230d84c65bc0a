"""Builds from the command line: run here when no worker holds the data folder, else followed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from app.jobs.handlers import handle_build, recover
from app.jobs.lock import WorkerLock
from app.jobs.worker import LOCK_NAME
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.builds import Build, claim_build, get_build

POLL_S = 0.3


def finish_build_here(resources: Resources, build_id: str, watch: Callable[[Build], None]) -> Build:
    """See a queued build to its end and return it; `watch` is called with its state a few times a second.

    When a server's worker is there, that one runs it; otherwise this process does, on a thread of its own.
    """
    stop = threading.Event()
    thread = threading.Thread(target=_work, args=(resources, build_id, stop), daemon=True)
    thread.start()
    try:
        while True:
            with resources.database.read() as connection:
                build = get_build(connection, build_id)
            watch(build)
            if build.ended:
                return build
            time.sleep(POLL_S)
    finally:
        stop.set()
        thread.join()


def _work(resources: Resources, build_id: str, stop: threading.Event) -> None:
    """Take builds from the queue until ours has ended, as soon as the lock of the data folder is free."""
    with WorkerLock(resources.settings.data_dir / LOCK_NAME, stop) as held:
        if not held:
            return
        library = MapLibrary(resources)
        recover(resources)
        while not stop.is_set():
            with resources.database.write() as connection:
                if get_build(connection, build_id).ended:
                    return
                build = claim_build(connection)
            if build is not None:
                handle_build(build, resources, library)
