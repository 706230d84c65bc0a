"""A server that leaves in good order when it is asked to stop: no request behind a balancer fails."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType

import uvicorn

from app.api.answers.drain import Drain, keep_event_streams
from app.limits import limit

log = logging.getLogger("roomfix")


@dataclass(frozen=True, slots=True, kw_only=True)
class LeavingOptions:
    """How long a server that stops waits."""

    arriving_s: float = limit(
        0.2,
        "Time after the port is closed in which requests of connections that were just made may arrive.",
        chosen="By hand: on a network that a balancer uses, a request follows its connection within milliseconds.",
    )
    streams_s: float = limit(
        5.0,
        "Time that streams have to answer the frames that they work on.",
        chosen="By hand: a slow frame takes about 1 s.",
    )
    answers_s: int = limit(
        30,
        "Time that requests have to be answered before their connections are cut.",
        chosen="By hand: half of what the compose file and the manifests leave until the process is killed.",
    )
    poll_s: float = limit(
        0.02, "Time between two checks of streams.", chosen="By hand: below a frame's time."
    )


OPTIONS = LeavingOptions()


class LeavingServer(uvicorn.Server):
    """Uvicorn's server, which at SIGTERM is not ready for `drain_s` and serves on, then closes its port, its streams,
    and ends when all is answered. SIGINT, or a second signal, skips the time in which it serves on.

    `on_started` is called when the app has started.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        drain: Drain,
        drain_s: float,
        on_started: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(config)
        self._on_started = on_started
        self._drain, self._drain_s = drain, drain_s
        self._signals: list[int] = []
        self._leaves_at: float | None = None
        keep_event_streams()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the app and listen."""
        await super().startup(sockets)
        self._on_started()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note the signal."""
        self._signals.append(sig)
        super().handle_exit(sig, frame)

    async def on_tick(self, counter: int) -> bool:
        """Return whether it is time to close the port."""
        if not await super().on_tick(counter):
            return False
        now = asyncio.get_running_loop().time()
        if self._leaves_at is None:
            self._leaves_at = now + (self._drain_s if self._signals == [signal.SIGTERM] else 0.0)
            self._drain.is_leaving = True
            log.info("stopping: the port closes in %.1f s", self._leaves_at - now)
        return len(self._signals) > 1 or now >= self._leaves_at

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take no more connections, close the streams, and wait for the answers."""
        for server in self.servers:
            server.close()
        if not self.force_exit:
            await asyncio.sleep(OPTIONS.arriving_s)
            await self._drain.close(OPTIONS.streams_s, OPTIONS.poll_s)
        await super().shutdown(sockets)
