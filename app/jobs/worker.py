"""The worker process: takes builds from the queue, one at a time.

One worker may run per data folder; a lock file that the kernel releases with the process proves it, so that a
worker that starts knows every build marked as running to be one whose worker died.
"""

from __future__ import annotations

import fcntl
import logging
import os
import signal
import sys
import threading
import time
from io import BufferedRandom
from pathlib import Path

from app.jobs.handlers import handle_build
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.settings import Settings
from app.storage.builds import claim_build, recover_builds
from app.storage.sweep import sweep_blobs

log = logging.getLogger("roomfix.worker")
POLL_S = 2.0
SWEEP_INTERVAL_S = 3600.0


def run_worker(settings: Settings, wake: threading.Event, stop: threading.Event) -> None:
    """Run builds until `stop` is set; waits first until no other worker holds the data folder."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    with _lock(settings.data_dir / "worker.lock", stop) as locked:
        if locked is None:
            return
        resources = Resources.open(settings)
        try:
            _serve(resources, wake, stop)
        finally:
            resources.close()


def _serve(resources: Resources, wake: threading.Event, stop: threading.Event) -> None:
    library = MapLibrary(resources)
    with resources.database.write() as connection:
        requeued, failed = recover_builds(connection)
    for build_id in requeued:
        log.warning("build %s lost its worker and is queued again", build_id)
    for build_id in failed:
        log.error("build %s lost its worker too often and has failed", build_id)
    swept = float("-inf")
    while not stop.is_set():
        wake.clear()
        with resources.database.write() as connection:
            build = claim_build(connection)
        if build is not None:
            log.info("build %s of venue %s starts", build.id, build.venue_id)
            handle_build(build, resources, library)
            continue
        if time.monotonic() - swept > SWEEP_INTERVAL_S:
            swept = time.monotonic()
            sweep_blobs(resources.database, resources.blobs)
        wake.wait(POLL_S)


class _lock:  # noqa: N801
    """Holds a lock file; gives None when `stop` came first."""

    def __init__(self, path: Path, stop: threading.Event) -> None:
        self._path = path
        self._stop = stop
        self._file: BufferedRandom | None = None

    def __enter__(self) -> BufferedRandom | None:
        self._file = self._path.open("a+b")
        while not self._stop.is_set():
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._stop.wait(0.2)
            else:
                return self._file
        return None

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()


def _follow_parent(wake: threading.Event) -> None:
    """Wake at each line from the server; end with it, at once, when the pipe closes."""
    while sys.stdin.buffer.readline():
        wake.set()
    os._exit(0)


def main() -> None:
    """Run as the embedded worker: standard input is the pipe from the server."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    wake, stop = threading.Event(), threading.Event()
    # A build is safe to cut anywhere, so ending at once is the right way to end.
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow_parent, args=(wake,), daemon=True).start()
    run_worker(Settings(), wake, stop)


if __name__ == "__main__":
    main()
