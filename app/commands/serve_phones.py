"""One server behind two doors: open on loopback as it was, and by https with a key for phones."""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import uvicorn

from app.api.access.open_host import OpenHostMiddleware
from app.commands.console import console
from app.commands.https import print_phone_access
from app.commands.serve import ALL_ADDRESSES, phone_access, run_server, server_options
from app.main import create_app
from app.services.keys.key_service import OPTIONS, key_service
from app.settings import Settings

STARTED_POLL_S = 0.05
# The longest life that a token may have.
TOKEN_LIFE_S = OPTIONS.max_token_expiry_s
AsgiApp = Callable[[Any, Any, Any], Awaitable[None]]


class WithKey:
    """Gives requests without a key this one: for a listener that only this machine reaches."""

    def __init__(self, app: AsgiApp, key: str) -> None:
        self._app = app
        self._header = (b"authorization", f"Bearer {key}".encode())

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve one request."""
        if scope["type"] in ("http", "websocket"):
            headers = list(scope["headers"])
            if not any(name == b"authorization" for name, _ in headers):
                scope = {**scope, "headers": [*headers, self._header]}
        await self._app(scope, receive, send)


def run_for_phones(settings: Settings, https_port: int, path: str, venue: str) -> None:
    """Serve open on the settings' loopback address, and by https on all addresses with a key made for this run.

    Prints the QR code of `path` with a token that may locate in the venue. Without a free port for https only loopback
    is served.
    """
    if not _is_free(https_port):
        console.print(
            f"Port {https_port} is in use, so phones can't be served; see --https-port.", soft_wrap=True
        )
        run_server(settings)
        return
    key = secrets.token_urlsafe(12)
    keyed = {"open": False, "admin_key": key, "host": ALL_ADDRESSES, "port": https_port}
    for_phones = Settings(**{**settings.model_dump(), **keyed})
    access, certificate = phone_access(for_phones)
    app = create_app(for_phones, access=access)
    print_phone_access(access, f"{path}#token={phone_token(for_phones, key, venue)}")
    local = uvicorn.Server(uvicorn.Config(OpenHostMiddleware(WithKey(app, key)), **server_options(settings)))
    phones = uvicorn.Server(uvicorn.Config(app, lifespan="off", **server_options(for_phones, certificate)))
    asyncio.run(_serve(local, phones))


def phone_token(settings: Settings, key: str, venue: str) -> str:
    """Return a token for the phones of a day, which may locate in one venue and nothing else; `key` vouches for it."""
    with key_service(settings) as keys:
        return keys.create_token(keys.identify(key), venue, TOKEN_LIFE_S).text


async def _serve(local: uvicorn.Server, phones: uvicorn.Server) -> None:
    """Run both until interrupted; the first one opens and closes what they share."""

    async def when_started() -> None:
        while not local.started and not local.should_exit:
            await asyncio.sleep(STARTED_POLL_S)
        await phones.serve()
        local.should_exit = True

    await asyncio.gather(local.serve(), when_started())


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((ALL_ADDRESSES, port))
        except OSError:
            return False
        return True
