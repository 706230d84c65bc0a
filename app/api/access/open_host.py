"""An open server answers this machine alone: no page of another site may use it through the browser."""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from app.api.access.credentials import is_loopback
from app.api.errors import problem, status_of
from app.errors import ForeignCallerError


class OpenHostMiddleware:
    """Refuses requests and WebSockets whose `Host` or `Origin` is not of loopback.

    A page elsewhere reaches a server on loopback by a name that it lets point there (DNS rebinding), or by a plain
    form; in the first case `Host` gives it away, in the second `Origin`. `origins` may call too.
    """

    def __init__(self, app: ASGIApp, origins: tuple[str, ...] = ()) -> None:
        self._app = app
        self._origins = origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        error = self._refusal(Headers(scope=scope))
        if error is None:
            await self._app(scope, receive, send)
            return
        response = problem(status_of(error), error.code, str(error))
        if scope["type"] == "http":
            await response(scope, receive, send)
        else:
            await WebSocket(scope, receive, send).send_denial_response(response)

    def _refusal(self, headers: Headers) -> ForeignCallerError | None:
        if not is_loopback(_host(f"//{headers.get('host', '')}")):
            return ForeignCallerError(
                "An open server answers at localhost or 127.0.0.1 only; start it with keys to serve other names."
            )
        origin = headers.get("origin")
        if origin is not None and origin not in self._origins and not is_loopback(_host(origin)):
            return ForeignCallerError(
                "An open server answers pages of this machine only; start it with keys to serve other sites."
            )
        return None


def _host(address: str) -> str:
    try:
        return urlsplit(address).hostname or ""
    except ValueError:
        return ""
