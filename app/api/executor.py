"""The bounded executor between the event loop and the CPU work."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import TypeVar

from app.errors import BusyError

Result = TypeVar("Result")


class BoundedExecutor:
    """Runs at most `workers` calls at once and lets at most `queue_size` more wait."""

    def __init__(self, workers: int, queue_size: int) -> None:
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="query")
        self._capacity = workers + queue_size
        self._lock = Lock()
        self._pending = 0

    @property
    def pending(self) -> int:
        """How many calls run or wait."""
        return self._pending

    async def run(self, function: Callable[[], Result]) -> Result:
        """Run a call on a worker thread; raises `BusyError` at once when the queue is full."""
        with self._lock:
            if self._pending >= self._capacity:
                raise BusyError("The server is busy: all workers are occupied and the queue is full.")
            self._pending += 1
        # Counted down by the work itself: a client that goes away doesn't free the thread that works for it.
        return await asyncio.wrap_future(self._pool.submit(self._counted, function))

    def _counted(self, function: Callable[[], Result]) -> Result:
        try:
            return function()
        finally:
            with self._lock:
                self._pending -= 1

    def close(self) -> None:
        """Wait for what runs and drop what waits."""
        self._pool.shutdown(wait=True, cancel_futures=True)
