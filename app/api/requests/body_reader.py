"""Bodies of requests: gzip is inflated, other encodings and bodies over the limit of their route are refused."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, NoReturn

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.errors import problem, status_of
from app.api.requests.names import shown
from app.errors import InvalidInputError, RoomfixError, UploadTooLargeError
from app.limits import limit

# Where a request's scope holds its `BodyReader`.
BODY = "roomfix.body"
# What a route takes, from the smallest to the largest.
Kind = Literal["json", "features", "image", "archive"]
GZIP_NAMES = ("gzip", "x-gzip")
# Of zlib: a gzip header, and the largest window.
GZIP_WINDOW_BITS = 16 + zlib.MAX_WBITS


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyOptions:
    """How bodies of requests are read."""

    max_json_bytes: int = limit(
        1_000_000,
        "Largest JSON body of a route that takes no file.",
        chosen="By hand: an anchor with all the POIs and corners that are allowed has about 100 kB.",
    )
    max_features_bytes: int = limit(
        25_000_000,
        "Largest GeoJSON body of a floor's features.",
        chosen="By hand: a floor with tens of thousands of corners has a few megabytes.",
    )
    form_overhead_bytes: int = limit(
        1_000_000,
        "Bytes that a body may have beside the file it carries: the other fields of a form and its boundaries.",
        chosen="By hand: options and hints have a few kilobytes.",
    )
    inflated_input_bytes: int = limit(
        4096,
        "Compressed bytes that are inflated at a time.",
        chosen="By hand: zlib copies what follows the end of a gzip member, which is cheap for few bytes even if there "
        "are many members.",
    )
    inflated_piece_bytes: int = limit(
        65_536,
        "Largest piece of an inflated body that is passed on at a time.",
        chosen="By hand: as large as the pieces that a server receives, so that memory doesn't grow with the ratio of "
        "compression.",
    )


OPTIONS = BodyOptions()


class RequestBodyMiddleware:
    """Inflates gzip bodies for the app, and answers requests whose body can't be read.

    A body over the limit of its route is a 413: at once when its declared length is over it, else as soon as it passes
    the limit; the length after inflation counts. Until the route has set its limit that of JSON holds. An encoding
    other than gzip is a 415, broken gzip a 422.
    """

    def __init__(self, app: ASGIApp, max_archive_bytes: int, max_image_bytes: int) -> None:
        self._app = app
        self._max_bytes: dict[Kind, int] = {
            "json": OPTIONS.max_json_bytes,
            "features": OPTIONS.max_features_bytes,
            "image": max_image_bytes + OPTIONS.form_overhead_bytes,
            "archive": max_archive_bytes + OPTIONS.form_overhead_bytes,
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        encodings = encodings_of(headers.getlist("content-encoding"))
        if encodings and (len(encodings) > 1 or encodings[0] not in GZIP_NAMES):
            await _unsupported(encodings)(scope, receive, send)
            return
        declared = headers.get("content-length", "0")
        declared_bytes = int(declared) if declared.isdigit() else 0
        body = BodyReader(receive, self._max_bytes, declared_bytes, is_gzip=bool(encodings))
        scope[BODY] = body

        async def send_unless_refused(event: Message) -> None:
            # Whatever the app makes of the error, the answer is the one below.
            if body.refused is None:
                await send(event)

        with suppress(BodyError):
            await self._app(scope, body.receive, send_unless_refused)
        if body.refused is not None:
            error = body.refused
            await problem(status_of(error), error.code, str(error))(scope, receive, send)


class BodyError(Exception):
    """A body that can't be read on; `BodyReader.refused` says why."""


class BodyReader:
    """The body of one request, as the app receives it; `refused` is the error that ended it."""

    def __init__(
        self, receive: Receive, max_bytes: dict[Kind, int], declared_bytes: int, *, is_gzip: bool
    ) -> None:
        self.refused: RoomfixError | None = None
        self._max_bytes = max_bytes
        self._limit_bytes = max_bytes["json"]
        self._declared_bytes = declared_bytes
        self._receive = receive
        self._received_bytes = 0
        self._inflater = Inflater() if is_gzip else None
        self._is_all_read = False

    def expect(self, kind: Kind) -> None:
        """Set the limit of what a route takes; raises `BodyError` when the declared length is over it."""
        self._limit_bytes = self._max_bytes[kind]
        if self._declared_bytes > self._limit_bytes:
            self._refuse(self._too_large())

    def _too_large(self) -> UploadTooLargeError:
        return UploadTooLargeError(
            f"The upload is larger than {self._limit_bytes:,} bytes, the limit of this call."
        )

    async def receive(self) -> Message:
        """Return the next message of the request; raises `BodyError` when its body can't be read on."""
        if self.refused is not None:
            raise BodyError
        if self._inflater is None:
            event = await self._receive()
        else:
            event = await self._receive_inflated(self._inflater)
        self._received_bytes += len(event.get("body", b""))
        if self._received_bytes > self._limit_bytes:
            self._refuse(self._too_large())
        return event

    async def _receive_inflated(self, inflater: Inflater) -> Message:
        while not (piece := self._inflated(inflater)):
            if self._is_all_read:
                if not inflater.is_at_end:
                    self._refuse(InvalidInputError("The gzip body ends before its end; send it whole."))
                self._inflater = None
                return {"type": "http.request", "body": b"", "more_body": False}
            event = await self._receive()
            if event["type"] != "http.request":
                return event
            inflater.feed(event.get("body", b""))
            self._is_all_read = not event.get("more_body", False)
        return {"type": "http.request", "body": piece, "more_body": True}

    def _inflated(self, inflater: Inflater) -> bytes:
        try:
            return inflater.inflate()
        except zlib.error:
            self._refuse(InvalidInputError("The body is not gzip, although its Content-Encoding says so."))

    def _refuse(self, error: RoomfixError) -> NoReturn:
        self.refused = error
        raise BodyError


class Inflater:
    """Inflates gzip (RFC 1952: members one after the other) piece by piece, so that no piece is large."""

    def __init__(self) -> None:
        self._member = zlib.decompressobj(GZIP_WINDOW_BITS)
        self._input = memoryview(b"")
        self.is_at_end = True

    def feed(self, data: bytes) -> None:
        """Take the next input; what came before must have been inflated."""
        self._input = memoryview(data)

    def inflate(self) -> bytes:
        """Return the next piece, empty when more input is needed; raises `zlib.error`."""
        while True:
            part = self._input[: OPTIONS.inflated_input_bytes]
            piece = self._member.decompress(part, OPTIONS.inflated_piece_bytes)
            rest = self._member.unused_data if self._member.eof else self._member.unconsumed_tail
            self._input = self._input[len(part) - len(rest) :]
            if len(part):
                self.is_at_end = False
            if self._member.eof:
                self._member, self.is_at_end = zlib.decompressobj(GZIP_WINDOW_BITS), True
            if piece or not len(self._input):
                return piece


def encodings_of(values: Iterable[str]) -> list[str]:
    """Return the encodings that `Content-Encoding` names, in lower case, without `identity`."""
    names = [name.strip().lower() for value in values for name in value.split(",")]
    return [name for name in names if name not in ("", "identity")]


def _unsupported(encodings: list[str]) -> Response:
    named = ", ".join(shown(name) for name in encodings)
    return problem(
        415,
        "unsupported_encoding",
        f"A body with Content-Encoding {named} is not read; send it with gzip, or without an encoding.",
        {"Accept-Encoding": "gzip, identity"},
    )
