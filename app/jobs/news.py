"""Wakes a worker when any process has queued a build, where the database has notices."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass

from app.limits import limit
from app.storage.builds import BUILD_QUEUED
from app.storage.db import Database

log = logging.getLogger("roomfix.jobs")


@dataclass(frozen=True, slots=True, kw_only=True)
class NewsOptions:
    """How notices are waited for."""

    look_s: float = limit(
        5.0,
        "Time of one wait for a notice.",
        chosen="By hand: a connection that broke is seen no later than this.",
    )
    retry_s: float = limit(
        2.0,
        "Pause before notices are asked for again after an error.",
        chosen="By hand: as often as the worker checks the queue by itself.",
    )


OPTIONS = NewsOptions()


class News:
    """A thread that sets `wake` at every notice. Without it the worker finds builds at its next check."""

    def __init__(self, database: Database, wake: threading.Event) -> None:
        self._database, self._wake = database, wake
        self._stopping = threading.Event()
        # Whether the last trial succeeded: what fails again and again is told once.
        self._is_heard = True
        self._thread = threading.Thread(target=self._run, name="build-news", daemon=True)

    def start(self) -> None:
        """Start to listen, where there is something to listen to."""
        if self._database.has_notices:
            self._thread.start()

    def stop(self) -> None:
        """End the thread after its present wait; doesn't wait for that."""
        self._stopping.set()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._listen()
            except Exception as error:
                if self._is_heard:
                    log.warning("no notices of new builds for now, the queue is checked without: %s", error)
                self._is_heard = False
                self._stopping.wait(OPTIONS.retry_s)

    def _listen(self) -> None:
        with self._database.notices(BUILD_QUEUED) as wait:
            # What was queued before is found by a check.
            self._is_heard = True
            self._wake.set()
            while not self._stopping.is_set():
                if wait(OPTIONS.look_s):
                    self._wake.set()
