"""Request ids and request metrics, as plain ASGI middleware."""

from __future__ import annotations

import logging
import re
import time
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.deps import EXTRA_HEADERS
from app.api.errors import problem
from app.api.metrics import Metrics
from app.logs import log_context

log = logging.getLogger("roomfix.api")
UNEXPECTED = "Something went wrong here; the log has it under this request's id."
EXPORT_PATH = "/export"
# Messages that begin an answer.
ANSWERS = ("http.response.start", "websocket.accept", "websocket.http.response.start")
REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class RequestIdMiddleware:
    """Gives every answer, and every line of the log while it is made, the request's id: the caller's own `X-Request-ID`
    if it is a sane one, else a new one. Adds the headers that were put aside meanwhile, such as those of a rate limit.

    Answers unexpected errors too: Starlette's own handler for them stands outside of all middleware.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or WebSocket."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get("x-request-id", "")
        request_id = given if REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
        with log_context(request_id=request_id):
            await self._serve(scope, receive, send, request_id)

    async def _serve(self, scope: Scope, receive: Receive, send: Send, request_id: str) -> None:
        started, began_s = False, time.perf_counter()
        more: dict[str, str] = {}
        scope[EXTRA_HEADERS] = more

        async def send_with_id(message: Message) -> None:
            nonlocal started
            if message["type"] in ANSWERS:
                started = True
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                headers.update(more)
                self._note(scope, message.get("status", 101), time.perf_counter() - began_s)
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            method = scope.get("method", "WS")
            log.exception("request %s: %s %s failed", request_id, method, scope["path"])
            if started or scope["type"] == "websocket":
                raise
            await problem(500, "internal", UNEXPECTED)(scope, receive, send_with_id)

    @staticmethod
    def _note(scope: Scope, status: int, seconds: float) -> None:
        """Log an answer: in detail only, unless the server has failed."""
        level = logging.WARNING if status >= 500 else logging.DEBUG
        log.log(
            level, "%s %s: %d in %.0f ms", scope.get("method", "WS"), scope["path"], status, 1e3 * seconds
        )


class CompressionMiddleware(GZipMiddleware):
    """Compresses answers, but not the file of a venue: it holds what is packed already, and its length is stated."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        is_file = scope["type"] == "http" and scope["path"].endswith(EXPORT_PATH)
        await (self.app(scope, receive, send) if is_file else super().__call__(scope, receive, send))


class MetricsMiddleware:
    """Counts requests by route and status, and times them."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started, status = time.perf_counter(), 500

        async def send_and_note(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, send_and_note)
        finally:
            # The template, not the path: ids in a label would make a series each.
            route = getattr(scope.get("route"), "path", "unmatched")
            self._metrics.observe_request(scope["method"], route, status, time.perf_counter() - started)
