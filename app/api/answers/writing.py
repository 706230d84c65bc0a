"""How answers are written: in pieces, so that what a client doesn't read stays out of the connection's buffer, and with
a bound on the sum of all that are being written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.errors import problem_of
from app.errors import BusyError
from app.limits import limit

FULL = "The server is busy: too many large answers are being read slowly. Try again later."


@dataclass(frozen=True, slots=True, kw_only=True)
class WritingOptions:
    """How large answers are written."""

    piece_bytes: int = limit(
        65_536,
        "Bytes that are given to a connection at once.",
        chosen="By hand: the size of its buffer above which the server waits.",
    )
    written_bytes: int = limit(
        200_000_000,
        "Sum of the sizes of the answers larger than a piece that are being written; a body that several answers "
        "share counts once. One answer alone may be larger.",
        chosen="By hand: some tens of the largest plans, less than a process takes for its maps.",
    )


OPTIONS = WritingOptions()


class Written:
    """The bodies that are being written."""

    def __init__(self, capacity_bytes: int) -> None:
        self._capacity = capacity_bytes
        # By identity: the body and the number of answers that share it.
        self._bodies: dict[int, tuple[bytes, int]] = {}

    @property
    def total(self) -> int:
        """The sum of the sizes of the bodies."""
        return sum(len(body) for body, _ in self._bodies.values())

    @contextmanager
    def holding(self, body: bytes) -> Iterator[None]:
        """Count a body while it is written; raises `BusyError` when it doesn't fit."""
        _, users = self._bodies.get(id(body), (body, 0))
        if users == 0 and self._bodies and self.total + len(body) > self._capacity:
            raise BusyError(FULL)
        self._bodies[id(body)] = (body, users + 1)
        try:
            yield
        finally:
            _, users = self._bodies.pop(id(body))
            if users > 1:
                self._bodies[id(body)] = (body, users - 1)


class WritingMiddleware:
    """Writes large bodies in pieces, each after the one before has mostly been read; answers 503 in place of one that
    doesn't fit beside those that are being written."""

    def __init__(self, app: ASGIApp, options: WritingOptions = OPTIONS) -> None:
        self._app = app
        self._piece = options.piece_bytes
        self._written = Written(options.written_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start: Message | None = None

        async def send_in_pieces(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = message
                return
            body = message.get("body", b"")
            # Of a streamed answer a part alone is in memory at any time.
            if start is None or len(body) <= self._piece or message.get("more_body"):
                begin, start = start, None
                if begin is not None:
                    await send(begin)
                await self._send(send, message)
                return
            try:
                with self._written.holding(body):
                    begin, start = start, None
                    await send(begin)
                    await self._send(send, message)
            except BusyError as error:
                start = None
                await problem_of(error)(scope, receive, send)

        await self._app(scope, receive, send_in_pieces)

    async def _send(self, send: Send, message: Message) -> None:
        """Send a message, a large body in pieces."""
        body = message.get("body", b"")
        last = 0
        while len(body) - last > self._piece:
            piece = body[last : last + self._piece]
            await send({**message, "body": piece, "more_body": True})
            last += self._piece
        await send({**message, "body": body[last:]} if last else message)
