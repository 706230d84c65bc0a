"""A balancer of TCP connections that asks its servers whether they are ready, as those of deploy/ do."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from urllib.parse import urlsplit

from bench.overload.request import ask, get_request

PIECE_BYTES = 65_536
HEALTH_S = 0.5


class Balancer:
    """Gives each connection to the next server that is ready, and to another when that one can't be reached."""

    def __init__(self) -> None:
        self.servers: list[str] = []
        self.ready: set[str] = set()
        self._turn = 0

    async def check(self) -> None:
        """Ask all servers whether they are ready."""
        for url in list(self.servers):
            answer = await ask(url, get_request(url, "/readyz"))
            (self.ready.add if answer.status == 200 else self.ready.discard)(url)

    async def watch(self) -> None:
        """Ask them again and again."""
        while True:
            await self.check()
            await asyncio.sleep(HEALTH_S)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass the bytes of one connection on until one of its ends closes it."""
        try:
            for url in self._in_turn():
                address = urlsplit(url)
                try:
                    from_server, to_server = await asyncio.open_connection(address.hostname, address.port)
                except ConnectionError:
                    continue
                await _joined(reader, writer, from_server, to_server)
                return
        finally:
            writer.close()

    def _in_turn(self) -> list[str]:
        self._turn += 1
        ready = [url for url in self.servers if url in self.ready]
        first = self._turn % max(1, len(ready))
        return ready[first:] + ready[:first]


@asynccontextmanager
async def balancing() -> AsyncIterator[tuple[str, Balancer]]:
    """Give the address of a balancer without servers, and the balancer."""
    balancer = Balancer()
    listener = await asyncio.start_server(balancer.serve, "127.0.0.1", 0)
    watching = asyncio.create_task(balancer.watch())
    try:
        yield f"http://127.0.0.1:{listener.sockets[0].getsockname()[1]}", balancer
    finally:
        watching.cancel()
        listener.close()


async def _joined(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    from_server: asyncio.StreamReader,
    to_server: asyncio.StreamWriter,
) -> None:
    ways = [asyncio.create_task(_pass(reader, to_server)), asyncio.create_task(_pass(from_server, writer))]
    try:
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for way in ways:
            way.cancel()
        to_server.close()


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(ConnectionError):
        while piece := await reader.read(PIECE_BYTES):
            writer.write(piece)
            await writer.drain()
