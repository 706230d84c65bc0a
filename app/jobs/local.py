"""Builds from the command line: run in this process unless a worker has taken them, else only followed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from app.jobs.handlers import handle_build, recover
from app.jobs.lease import Heart, LeaseWatch
from app.jobs.worker_name import worker_name
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

    A worker of a running server runs it, or a thread of this process, whichever takes it first.
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
    """Run the build unless a worker has taken it, and take it up when that one dies."""
    worker, watch = worker_name(), LeaseWatch()
    heart = Heart(resources.database, worker)
    heart.start()
    try:
        library = MapLibrary(resources)
        while not stop.wait(OPTIONS.poll_s):
            recover(resources, watch)
            with resources.database.write() as connection:
                if get_build(connection, build_id).ended:
                    return
                build = claim_build(connection, worker, build_id)
            if build is not None:
                handle_build(build, resources, library)
    finally:
        heart.stop()
