"""Queries that are refused before anything of them is read, or dropped since nobody waits for them any more."""

from __future__ import annotations

import asyncio
import re

from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.deps import AppState
from app.api.errors import problem_of
from app.api.executor import CLIENT_GONE, ClientGoneError
from app.engine.stage_timer import IS_WANTED
from app.errors import BusyError

# The calls that are answered by the bounded executor and carry an image.
COMPUTED = re.compile(r"/locate|/sessions/[^/]+/frames|/anchors/[^/]+/(frames|calibrate)")


# Those that leave nothing behind, so that they can be given up at any moment.
STATELESS = {"/locate"}
# As proxies log it; nobody receives it.
CLIENT_CLOSED_REQUEST = 499


class OverloadMiddleware:
    """Answers 503 when the queue is full, before the image of a query was read, and lets the executor know when the
    client of a query has gone."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        is_computed = (
            scope["type"] == "http" and scope["method"] == "POST" and COMPUTED.fullmatch(scope["path"])
        )
        if not is_computed:
            await self._app(scope, receive, send)
            return
        state = scope["app"].state.roomfix
        assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
        try:
            state.executor.check_room()
        except BusyError as error:
            await problem_of(error)(scope, receive, send)
            return
        watched = WatchedRequest(receive)
        CLIENT_GONE.set(watched.gone)
        if scope["path"] in STATELESS:
            IS_WANTED.set(lambda: not watched.gone.is_set())
        try:
            await self._app(scope, watched.receive, send)
        except ClientGoneError:
            await Response(status_code=CLIENT_CLOSED_REQUEST)(scope, receive, send)
        finally:
            watched.close()


class WatchedRequest:
    """A request that is listened to after its body has ended: all that can follow is that the client goes."""

    def __init__(self, receive: Receive) -> None:
        self.gone = asyncio.Event()
        self._receive = receive
        self._rest: asyncio.Task[Message] | None = None

    async def receive(self) -> Message:
        """Return the next message."""
        if self._rest is not None:
            return await asyncio.shield(self._rest)
        message = await self._next()
        if message["type"] == "http.request" and not message.get("more_body", False):
            self._rest = asyncio.create_task(self._next())
        return message

    def close(self) -> None:
        """Listen no longer."""
        if self._rest is not None:
            self._rest.cancel()

    async def _next(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.disconnect":
            self.gone.set()
        return message
