"""Queries that are refused before anything of them is read, since there is no room."""

from __future__ import annotations

import re

from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.deps import AppState
from app.api.errors import problem_of
from app.errors import BusyError

# The calls that are answered by the bounded executor and carry an image.
COMPUTED = re.compile(r"/locate|/sessions/[^/]+/frames|/anchors/[^/]+/(frames|calibrate)")


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
