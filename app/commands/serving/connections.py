"""Bounds on what a connection may cost: requests that are never finished, answers that are never read, and messages in
countless fragments."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from app.limits import limit

TIMEOUT_ANSWER = b"HTTP/1.1 408 Request Timeout\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"
# Close code of RFC 6455: a message is too large.
CLOSE_TOO_BIG = 1009


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionOptions:
    """How long a connection may wait, and how a message may arrive."""

    headers_s: float = limit(
        15.0,
        "Time from the start of a connection or request until its headers are there.",
        chosen="By hand: headers fit in one packet, which a bad mobile network delivers within seconds.",
    )
    silence_s: float = limit(
        30.0,
        "Time without a byte of a body that has not ended.",
        chosen="By hand: a phone that changes its network is back sooner.",
    )
    unread_s: float = limit(
        60.0,
        "Time in which a client that is behind must read what its connection holds, 64 KB and what the kernel holds.",
        chosen="By hand: a thousand bytes a second, far below what a bad mobile network takes.",
    )
    check_s: float = limit(
        1.0, "Time between two checks of a connection.", chosen="By hand: no load, and exact enough."
    )
    max_fragments: int = limit(
        4096,
        "Fragments of one WebSocket message.",
        chosen="By hand: browsers send frames of 64 KB and more, so that the largest image has some hundred.",
    )


OPTIONS = ConnectionOptions()


class DeadlineProtocol(HttpToolsProtocol):
    """HTTP whose requests must arrive, headers within a time, bodies without long silence, and whose answers must be
    read."""

    options = OPTIONS

    def connection_made(self, transport: Any) -> None:
        """Start to watch the connection."""
        super().connection_made(transport)
        self._headers_since: float | None = self.loop.time()
        self._received = self.loop.time()
        self._written = self.loop.time()
        self._watch = self.loop.call_later(self.options.check_s, self._check)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop to watch it."""
        self._watch.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Note when bytes arrive."""
        self._received = self.loop.time()
        super().data_received(data)

    def on_message_begin(self) -> None:
        """Note when a request begins."""
        self._headers_since = self.loop.time()
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Note that the headers are there."""
        self._headers_since = None
        super().on_headers_complete()

    def handle_websocket_upgrade(self) -> None:
        """Leave the connection to the WebSocket's protocol, which has deadlines of its own."""
        self._watch.cancel()
        super().handle_websocket_upgrade()

    def _check(self) -> None:
        now = self.loop.time()
        if not self.flow.write_paused:
            self._written = now
        elif now - self._written > self.options.unread_s:
            # An ordinary close would wait until all is read.
            self.transport.abort()
            return
        late = self._headers_since is not None and now - self._headers_since > self.options.headers_s
        cycle = self.cycle
        is_reading = cycle is not None and cycle.more_body and not cycle.response_complete
        # While the app is behind, the server itself doesn't read.
        silent = is_reading and not self.flow.read_paused and now - self._received > self.options.silence_s
        if late or silent:
            if cycle is None or cycle.response_complete or not cycle.response_started:
                self.transport.write(TIMEOUT_ANSWER)
            self.transport.close()
            return
        self._watch = self.loop.call_later(self.options.check_s, self._check)


class FragmentLimitProtocol(WebSocketsSansIOProtocol):
    """WebSockets whose messages have a limited number of fragments: each costs time, however small it is."""

    options = OPTIONS

    def handle_events(self) -> None:
        """Handle what has arrived, unless the connection is being closed for its fragments."""
        if not self.transport.is_closing():
            super().handle_events()

    def handle_cont(self, event: Any) -> None:
        """Take a fragment; one too many closes the connection."""
        if self.transport.is_closing():
            return
        if len(self.frames) >= self.options.max_fragments:
            self.frames = []
            self.conn.fail(CLOSE_TOO_BIG, f"A message has at most {self.options.max_fragments} fragments.")
            self.handle_parser_exception()
            return
        super().handle_cont(event)


def connection_options() -> dict[str, Any]:
    """Return the protocols as options of `uvicorn.run`."""
    protocol: type[asyncio.Protocol] = DeadlineProtocol
    return {"http": protocol, "ws": FragmentLimitProtocol}
