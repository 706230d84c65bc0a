"""The pages people open: the start page and the API page, with all their assets served from here."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.datastructures import MutableHeaders
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

STATIC = Path(__file__).parent / "static"
# Swagger UI as it is released; the package's own app factory is not used.
SWAGGER_UI = Path(str(files("fastapi_offline"))) / "static"

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


def install_pages(app: FastAPI) -> None:
    """Add `/`, `/docs` and their assets to the app."""

    def start_page() -> FileResponse:
        return FileResponse(STATIC / "index.html", headers=PAGE_HEADERS)

    def api_page() -> FileResponse:
        return FileResponse(STATIC / "docs.html", headers=PAGE_HEADERS)

    app.add_api_route("/", start_page, include_in_schema=False)
    app.add_api_route("/docs", api_page, include_in_schema=False)
    app.mount("/docs/assets", WithHeaders(StaticFiles(directory=SWAGGER_UI), PAGE_HEADERS), name="swagger-ui")
    app.mount("/assets", WithHeaders(StaticFiles(directory=STATIC), PAGE_HEADERS), name="assets")
