"""Builds from the command line: run in this process when no worker holds the data folder, else only followed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from app.jobs.handlers import handle_build, recover
from app.jobs.lock import WorkerLock
from app.jobs.worker import LOCK_NAME
from app.limits import limit
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.builds import Build, claim_build, get_build


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalOptions:
    """How a build is followed."""

    poll_s: float = limit(
        0.3,
        "Time between two looks at the state of a build.",
        chosen="By hand: fast enough for a progress bar.",
    )


OPTIONS = LocalOptions()


def finish_build_here(resources: Resources, build_id: str, watch: Callable[[Build], None]) -> Build:
    """Return a queued build once it has ended; `watch` is called with it a few times a second.

    The worker of a running server runs it; without one a thread of this process does.
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
            time.sleep(OPTIONS.poll_s)
    finally:
        stop.set()
        thread.join()


def _work(resources: Resources, build_id: str, stop: threading.Event) -> None:
    """Wait for the lock of the data folder, then run builds from the queue until the given one has ended."""
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
