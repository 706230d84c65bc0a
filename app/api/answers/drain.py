"""How a server leaves: it says so and serves on, then its streams are closed, then the process ends."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from sse_starlette.sse import AppStatus
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Drain:
    """Whether this server is about to stop.

    While `is_leaving`, it still answers, but its balancer is to send no more. Once `closing` is set, connections that
    would stay open end after what they answer.
    """

    def __init__(self) -> None:
        self.is_leaving = False
        self.closing = asyncio.Event()
        self._open = 0

    @contextmanager
    def holding(self) -> Iterator[None]:
        """Count a connection that ends only when `closing` is set."""
        self._open += 1
        try:
            yield
        finally:
            self._open -= 1

    async def close(self, wait_s: float, poll_s: float) -> None:
        """Set `closing` and wait until the connections that are held have ended, for at most `wait_s`."""
        self.is_leaving = True
        self.closing.set()
        loop = asyncio.get_running_loop()
        until = loop.time() + wait_s
        while self._open and loop.time() < until:
            await asyncio.sleep(poll_s)


def keep_event_streams() -> None:
    """Let event streams of this process go on until `closing` is set.

    Their library would end them at the signal, and again each time that their reader comes back.
    """
    AppStatus.enable_automatic_graceful_drain = False


class LeavingMiddleware:
    """Closes each connection after its answer while the server is leaving, so that the next request goes elsewhere."""

    def __init__(self, app: ASGIApp, drain: Drain) -> None:
        self._app = app
        self._drain = drain

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""

        async def send_and_close(message: Message) -> None:
            if self._drain.is_leaving and message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, receive, send_and_close if scope["type"] == "http" else send)
