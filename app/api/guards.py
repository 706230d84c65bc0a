"""Requests that are refused before anything of them is read: from a page of another site, or when there is no room."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.deps import AppState
from app.api.errors import problem, problem_of
from app.errors import BusyError

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
# What a browser says of a request that a page of the server itself, or its user, has made.
OWN_SITE = ("same-origin", "none")
OTHER_SITE = (
    "This request comes from a page of another site. A server that was started open answers only its own pages and "
    "programs that are no browsers; give it a key to be called from elsewhere."
)
# The calls that are answered by the bounded executor and carry an image.
COMPUTED = re.compile(r"/locate|/sessions/[^/]+/frames|/anchors/[^/]+/(frames|calibrate)")


class OtherSitesMiddleware:
    """Refuses what a page of another site sends to a server without keys: the browser is all that it would need.

    Browsers say where a request comes from in `Sec-Fetch-Site` and `Origin`; other programs send neither. A page that
    has a name of this computer resolved to itself (DNS rebinding) shows by its `Origin`.
    """

    def __init__(self, app: ASGIApp, *, is_open: bool) -> None:
        self._app = app
        self._is_open = is_open

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or WebSocket."""
        if self._is_open and scope["type"] in ("http", "websocket") and is_from_other_site(scope):
            await problem(403, "cross_site", OTHER_SITE)(scope, receive, send)
            return
        await self._app(scope, receive, send)


def is_from_other_site(scope: Scope) -> bool:
    """Whether a request that could change something, or a WebSocket, comes from a page of another site."""
    if scope["type"] == "http" and scope["method"] in SAFE_METHODS:
        return False
    headers = Headers(scope=scope)
    if headers.get("sec-fetch-site", "none") not in OWN_SITE:
        return True
    origin = headers.get("origin")
    if origin is None:
        return False
    try:
        parts = urlsplit(origin)
        return parts.netloc != headers.get("host", "") or parts.hostname not in LOOPBACK_NAMES
    except ValueError:
        return True


class OverloadMiddleware:
    """Answers 503 when the queue is full, before the image of a query was read."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        is_computed = (
            scope["type"] == "http" and scope["method"] == "POST" and COMPUTED.fullmatch(scope["path"])
        )
        if is_computed:
            state = scope["app"].state.roomfix
            assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
            try:
                state.executor.check_room()
            except BusyError as error:
                await problem_of(error)(scope, receive, send)
                return
        await self._app(scope, receive, send)
