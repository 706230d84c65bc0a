"""The pages people open: start page, studio, phone page and API page, with all their assets served from here."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.web.phones import PhoneAccess, install_phone_routes

STATIC = Path(__file__).parent / "static"
# Swagger UI as it is released; the package's own app factory is not used.
SWAGGER_UI = Path(str(files("fastapi_offline"))) / "static"

# Address -> the file of the page.
PAGES = {
    "/": "index.html",
    "/studio": "studio.html",
    "/go/{venue}": "go.html",
    "/record/{venue}": "record.html",
    "/docs": "docs.html",
}

# blob: is for photos before they are sent and for plans, which are fetched with the key; data: for icons in
# style sheets. Nothing may come from, or go to, another host.
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
PAGE_HEADERS = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    # The browser asks each time whether a file has changed, so that an update never mixes old and new modules.
    "Cache-Control": "no-cache",
}


class WithHeaders:
    """Adds headers to all answers of an ASGI app."""

    def __init__(self, app: ASGIApp, headers: dict[str, str]) -> None:
        self._app = app
        self._headers = headers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        await self._app(scope, receive, send_with_headers)


def install_pages(app: FastAPI, access: PhoneAccess | None = None) -> None:
    """Add the pages, their assets and the list of their languages to the app; `access` is how phones reach it."""

    def languages() -> list[str]:
        return sorted(path.stem for path in (STATIC / "languages" / "go").glob("*.json"))

    for address, name in PAGES.items():
        app.add_api_route(address, _page(name), include_in_schema=False)
    # One catalogue file is one language: the phone page asks which there are.
    app.add_api_route("/assets/languages", languages, include_in_schema=False)
    install_phone_routes(app, access)
    app.mount("/docs/assets", _assets(SWAGGER_UI), name="swagger-ui")
    app.mount("/assets", _assets(STATIC), name="assets")


def _page(name: str) -> Callable[[], FileResponse]:
    return lambda: FileResponse(STATIC / name, headers=PAGE_HEADERS)


def _assets(folder: Path) -> ASGIApp:
    return WithHeaders(GZipMiddleware(StaticFiles(directory=folder)), PAGE_HEADERS)
