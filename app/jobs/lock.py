"""The lock of a data folder: one worker at a time holds it."""

from __future__ import annotations

import fcntl
import threading
from dataclasses import dataclass
from io import BufferedRandom
from pathlib import Path

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class LockOptions:
    """How a worker waits for its lock."""

    retry_s: float = limit(
        0.2, "Time between two attempts to take the lock.", chosen="By hand: no delay that anybody notices."
    )


OPTIONS = LockOptions()


class WorkerLock:
    """A lock file that the kernel releases when the process ends: its holder knows that no other worker is alive."""

    def __init__(self, path: Path, stop: threading.Event) -> None:
        self._path = path
        self._stop = stop
        self._file: BufferedRandom | None = None

    def __enter__(self) -> bool:
        """Wait for the lock; return False when `stop` was set first."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self._path.open("a+b")
        while not self._stop.is_set():
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._stop.wait(OPTIONS.retry_s)
            else:
                return True
        return False

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        if self._file is not None:
            self._file.close()
