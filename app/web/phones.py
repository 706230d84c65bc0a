"""How phones reach the server: its https address, its certificate authority, and QR codes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import segno
from fastapi import FastAPI, Query, Response
from fastapi.responses import FileResponse, JSONResponse

from app.limits import limit

AUTHORITY_TYPE = "application/x-x509-ca-cert"
AUTHORITY_NAME = "roomfix-authority.crt"


@dataclass(frozen=True, slots=True, kw_only=True)
class QrOptions:
    """QR codes for pages."""

    max_characters: int = limit(
        1000, "Longest text of a QR code.", chosen="By hand: phones read larger codes badly."
    )
    module_px: int = limit(8, "Pixels of a module of the code.", chosen="By hand: readable across a table.")


OPTIONS = QrOptions()


@dataclass(frozen=True, slots=True)
class PhoneAccess:
    """The address that phones open, and the file of the authority that they have to trust for it."""

    https: str
    authority: Path


def install_phone_routes(app: FastAPI, access: PhoneAccess | None) -> None:
    """Add the address for phones, the authority's certificate, and QR codes of any text to the app."""

    def addresses() -> JSONResponse:
        return JSONResponse({"https": None if access is None else access.https})

    def qr(
        text: Annotated[str, Query(min_length=1, max_length=OPTIONS.max_characters)],
    ) -> Response:
        drawn = io.BytesIO()
        code = segno.make(text, micro=False)
        code.save(drawn, kind="svg", scale=OPTIONS.module_px, light="white", xmldecl=False)
        return Response(drawn.getvalue(), media_type="image/svg+xml", headers=QR_HEADERS)

    app.add_api_route("/assets/addresses", addresses, include_in_schema=False)
    app.add_api_route("/assets/qr.svg", qr, include_in_schema=False)
    if access is not None:
        app.add_api_route(
            "/ca.crt",
            lambda: FileResponse(access.authority, media_type=AUTHORITY_TYPE, filename=AUTHORITY_NAME),
            include_in_schema=False,
        )


# Opened on its own, the picture runs and fetches nothing; the link in it may hold a token.
QR_HEADERS = {
    "Content-Security-Policy": "default-src 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
