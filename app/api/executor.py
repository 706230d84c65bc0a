"""The bounded executor between the event loop and the CPU work."""

from __future__ import annotations

import asyncio
import contextvars
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import Any, TypeVar

from app.engine.stage_timer import NotWantedError
from app.errors import BusyError

Result = TypeVar("Result")
# Set by the middleware of computed calls: is set when the client has closed its connection.
CLIENT_GONE: contextvars.ContextVar[asyncio.Event | None] = contextvars.ContextVar(
    "client_gone", default=None
)
FULL = "The server is busy: all workers are occupied and the queue is full."


class ClientGoneError(Exception):
    """Nobody waits for the answer any more; the work was not begun, or given up."""


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
        """Run a call on a worker thread; raises `BusyError` at once when the queue is full.

        A call that still waits when the client of the request has gone is taken out of the queue; one that runs is
        given up between two stages where it can be. This raises `ClientGoneError` then.
        """
        with self._lock:
            self.check_room()
            self._pending += 1
        # The context holds the request's id, which lines of the log carry.
        future = self._pool.submit(contextvars.copy_context().run, function)
        # Counted down when the work ends or is cancelled while it waits: a client that goes away doesn't free the
        # thread that works for it.
        future.add_done_callback(self._release)
        result = asyncio.wrap_future(future)
        gone = CLIENT_GONE.get()
        if gone is not None:
            leaving = asyncio.ensure_future(gone.wait())
            try:
                await asyncio.wait((result, leaving), return_when=asyncio.FIRST_COMPLETED)
            except asyncio.CancelledError:
                result.cancel()
                raise
            finally:
                leaving.cancel()
            if gone.is_set() and future.cancel():
                raise ClientGoneError
        try:
            return await result
        except NotWantedError:
            raise ClientGoneError from None

    def _release(self, _: Future[Any]) -> None:
        with self._lock:
            self._pending -= 1

    def close(self) -> None:
        """Wait for what runs and drop what waits."""
        self._pool.shutdown(wait=True, cancel_futures=True)
