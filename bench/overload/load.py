"""Loads: clients in turn, requests at a rate, clients that go away, clients that read slowly."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

from bench.overload.request import Answer, ask, get_request, open_connection
from bench.uploads.measure import resident_bytes

HEALTH_S = 0.2
MEMORY_S = 0.1
# A client that goes away does so within this time, a query's own time or less.
GONE_WITHIN_S = 0.3
# Between two small reads of a slow reader.
SLOW_READ_S = 0.2
SLOW_READ_BYTES = 64


@dataclass(slots=True)
class Observed:
    """What was seen while a load ran: answers of those who wait for them, of `/healthz`, and resident memory."""

    began_s: float
    seconds: float = 0.0
    answers: list[Answer] = field(default_factory=list)
    health: list[Answer] = field(default_factory=list)
    memory_bytes: list[int] = field(default_factory=list)

    @property
    def goodput(self) -> float:
        """Queries answered with 200 in a second."""
        return sum(answer.status == 200 for answer in self.answers) / self.seconds

    def of_status(self, status: int) -> list[float]:
        """Return the seconds of the answers with a status."""
        return [answer.seconds for answer in self.answers if answer.status == status]


@asynccontextmanager
async def observing(url: str, pid: int) -> AsyncIterator[Observed]:
    """Watch a server's health and memory while a load runs."""
    seen = Observed(time.perf_counter())

    async def watch_health() -> None:
        request = get_request(url, "/healthz")
        while True:
            seen.health.append(await ask(url, request))
            await asyncio.sleep(HEALTH_S)

    async def watch_memory() -> None:
        # Not after each answer of health: memory counts most while a server is too busy to give one.
        while True:
            seen.memory_bytes.append(resident_bytes(pid))
            await asyncio.sleep(MEMORY_S)

    tasks = [asyncio.create_task(watch_health()), asyncio.create_task(watch_memory())]
    try:
        yield seen
    finally:
        seen.seconds = time.perf_counter() - seen.began_s
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def clients_in_turn(seen: Observed, url: str, request: bytes, clients: int, seconds: float) -> None:
    """Let clients ask again and again, each after its answer."""
    end = time.perf_counter() + seconds

    async def client() -> None:
        while time.perf_counter() < end:
            answer = await ask(url, request)
            seen.answers.append(answer)
            if answer.status != 200:
                await asyncio.sleep(0.05)

    await asyncio.gather(*(client() for _ in range(clients)))


async def at_a_rate(seen: Observed, url: str, request: bytes, per_second: float, seconds: float) -> None:
    """Begin requests at a rate, whether or not those before were answered."""
    began, running = time.perf_counter(), set[asyncio.Task[None]]()

    async def one() -> None:
        seen.answers.append(await ask(url, request))

    for number in range(round(per_second * seconds)):
        await asyncio.sleep(max(0.0, began + number / per_second - time.perf_counter()))
        task = asyncio.create_task(one())
        running.add(task)
        task.add_done_callback(running.discard)
    await asyncio.gather(*running)


async def go_away(url: str, request: bytes, clients: int, seconds: float, seed: int = 0) -> None:
    """Let a number of clients ask, evenly over the time, and close their connection before the answer."""
    rng, began = random.Random(seed), time.perf_counter()

    async def one(wait_s: float) -> None:
        with suppress(OSError):
            _, writer = await open_connection(url)
            writer.write(request)
            await asyncio.sleep(wait_s)
            writer.transport.abort()

    tasks = []
    for number in range(clients):
        await asyncio.sleep(max(0.0, began + seconds * number / clients - time.perf_counter()))
        tasks.append(asyncio.create_task(one(rng.uniform(0.0, GONE_WITHIN_S))))
    await asyncio.gather(*tasks)


async def read_slowly(url: str, request: bytes, clients: int, is_over: Callable[[], bool]) -> None:
    """Let clients ask for a large answer and read a few bytes of it at a time, until it is over.

    One that is cut off, as a server does with clients that read too slowly, asks again.
    """

    async def one() -> None:
        while not is_over():
            with suppress(OSError):
                reader, writer = await open_connection(url)
                writer.write(request)
                while not is_over() and await reader.read(SLOW_READ_BYTES):
                    await asyncio.sleep(SLOW_READ_S)
                writer.transport.abort()
            await asyncio.sleep(SLOW_READ_S)

    await asyncio.gather(*(one() for _ in range(clients)))
