"""The bounded executor between the event loop and the CPU work."""

from __future__ import annotations

import asyncio
import contextvars
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import Any, TypeVar

from app.errors import BusyError

Result = TypeVar("Result")
FULL = "The server is busy: all workers are occupied and the queue is full."


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

    def check_room(self) -> None:
        """Raise `BusyError` when the queue is full."""
        if self._pending >= self._capacity:
            raise BusyError(FULL)

    async def run(self, function: Callable[[], Result]) -> Result:
        """Run a call on a worker thread; raises `BusyError` at once when the queue is full."""
        with self._lock:
            self.check_room()
            self._pending += 1
        # The context holds the request's id, which lines of the log carry.
        future = self._pool.submit(contextvars.copy_context().run, function)
        # Counted down when the work ends or is cancelled while it waits: a client that goes away doesn't free the
        # thread that works for it.
        future.add_done_callback(self._release)
        return await asyncio.wrap_future(future)

    def _release(self, _: Future[Any]) -> None:
        with self._lock:
            self._pending -= 1

    def close(self) -> None:
        """Wait for what runs and drop what waits."""
        self._pool.shutdown(wait=True, cancel_futures=True)
