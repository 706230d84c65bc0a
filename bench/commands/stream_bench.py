"""`roomfix stream-bench`: several phones that stream to one server at once, and how old their answers are."""

from __future__ import annotations

import asyncio
import time
from itertools import cycle, islice
from typing import Annotated

import httpx
import numpy as np
import typer
from rich.table import Table

from app.commands.stream import DEFAULT_SERVER, CameraText, Fps, Server, Source, Venue, admin_key
from app.commands.stream_client import StreamLog, read_frames, start_session, stream_frames
from bench.figures.shown import FiguresTitle, Shown

COLUMN = (
    "frames sent", "answered", "answers a second", "located %", "median ms", "95 % ms", "largest ms",
    "median ms, first third", "median ms, last third", "last frame answered",
)  # fmt: skip


def stream_bench(
    source: Source,
    venue: Venue,
    server: Server = DEFAULT_SERVER,
    camera: CameraText = None,
    fps: Fps = 10.0,
    phones: Annotated[int, typer.Option(min=1, max=100, help="Streams at the same time.")] = 4,
    seconds: Annotated[float, typer.Option(min=1, help="How long.")] = 20.0,
    figures: FiguresTitle = None,
) -> None:
    """Stream from several phones at once; print how old answers are, and whether they get older."""
    frames, key = read_frames(source), admin_key()
    count = round(fps * seconds)
    logs, pending = asyncio.run(_bench(frames, server, key, venue, camera, fps, phones, count))
    table = Table("phone", *(str(number + 1) for number in range(phones)))
    columns = [_column(log, seconds) for log in logs]
    for row, name in enumerate(COLUMN):
        table.add_row(name, *(column[row] for column in columns))
    shown = Shown()
    shown.table(table)
    shown.line(
        f"queries that run or wait in the server: {np.mean(pending):.1f} on average, {max(pending)} at most"
    )
    shown.write("stream-bench", figures)


async def _bench(
    frames: list[bytes],
    server: str,
    key: str | None,
    venue: str,
    camera: str | None,
    fps: float,
    phones: int,
    count: int,
) -> tuple[list[StreamLog], list[int]]:
    streams = []
    for number in range(phones):
        # Back and forth, each phone from another place on.
        there_and_back = cycle(frames + frames[-2:0:-1])
        start = number * len(frames) // phones
        own = list(islice(there_and_back, start, start + count))
        session = start_session(server, key, venue=venue, camera=camera)
        streams.append(stream_frames(server, session, own, fps=fps, key=key))
    watching = asyncio.create_task(_watch(server, key, count / fps))
    logs = await asyncio.gather(*streams)
    return list(logs), await watching


async def _watch(server: str, key: str | None, seconds: float) -> list[int]:
    """Return how many queries ran or waited in the server, twice a second."""
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    until, found = time.perf_counter() + seconds, []
    async with httpx.AsyncClient(base_url=server, headers=headers) as client:
        while time.perf_counter() < until:
            lines = (await client.get("/metrics")).text.splitlines()
            found += [
                int(float(line.split()[1])) for line in lines if line.startswith("roomfix_queries_pending ")
            ]
            await asyncio.sleep(0.5)
    return found or [0]


def _column(log: StreamLog, seconds: float) -> list[str]:
    """Return the figures of a phone, as `COLUMN` names them."""
    if not log.answers:
        return [str(log.sent), "0", *("-" for _ in COLUMN[2:])]
    ages = [answer.latency_ms for answer in log.answers]
    third = max(len(ages) // 3, 1)
    located = np.mean([bool(answer.body.get("located")) for answer in log.answers])
    newest = max(answer.sent for answer in log.answers) == log.last
    numbers = (
        len(ages) / seconds, 100 * located, np.median(ages), np.percentile(ages, 95), max(ages),
        np.median(ages[:third]), np.median(ages[-third:]),
    )  # fmt: skip
    shown = [f"{value:.1f}" for value in numbers]
    return [str(log.sent), str(len(ages)), *shown, "yes" if newest else "no"]
