"""The lock that lets one worker at a time hold a data folder."""

from __future__ import annotations

import fcntl
import threading
from io import BufferedRandom
from pathlib import Path

RETRY_S = 0.2


class WorkerLock:
    """A lock file that the kernel releases with the process: whoever holds it knows that no other worker lives."""

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
                self._stop.wait(RETRY_S)
            else:
                return True
        return False

    def __exit__(self, *_: object) -> None:
        """Give the lock back."""
        if self._file is not None:
            self._file.close()
