"""`roomfix overload`: goodput, refusals, health and memory of a server that is asked for too much."""

from __future__ import annotations

import asyncio
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import httpx
import numpy as np
import typer
from rich.table import Table

from app.errors import InvalidInputError
from bench.figures.shown import FiguresTitle, Shown
from bench.overload.load import Observed, at_a_rate, clients_in_turn, go_away, observing, read_slowly
from bench.overload.request import get_request, locate_request
from bench.server_process import ServerProcess, server_process

# Clients in turn that keep all workers busy, over the workers of the server.
FULL_RATIO = 2
WARM_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What a server is asked for."""

    request: bytes
    large_answer: bytes
    workers: int
    seconds: float
    times: float
    gone: int
    slow: int


def overload(
    data_dir: Annotated[Path, typer.Option(exists=True, file_okay=False, help="A data folder with a map.")],
    picture: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="A JPEG that the map locates.")],
    venue: Annotated[str, typer.Option(help="The venue of the map.")] = "demo",
    camera: Annotated[str | None, typer.Option(help="fx,fy,cx,cy of the picture.")] = None,
    seconds: Annotated[float, typer.Option(min=5, help="Seconds of each load.")] = 30.0,
    times: Annotated[
        float, typer.Option(min=1, help="Rate of requests over what the server can answer.")
    ] = 10.0,
    gone: Annotated[int, typer.Option(min=0, help="Clients that go away before their answer.")] = 500,
    slow: Annotated[int, typer.Option(min=0, help="Clients that read slowly.")] = 200,
    workers: Annotated[int, typer.Option(min=1, help="Threads of the server.")] = 2,
    figures: FiguresTitle = None,
) -> None:
    """Ask a server of its own, on a data folder's map, for more than it can do, and print what it answers."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "data"
        copy.mkdir()
        for path in data_dir.glob("roomfix.db*"):
            shutil.copy(path, copy)
        # Read alone: without a worker nothing is swept.
        (copy / "blobs").symlink_to((data_dir / "blobs").resolve())
        with server_process(copy, Path(folder) / "log", ROOMFIX_WORKERS=str(workers)) as server:
            load = Load(
                request=locate_request(server.url, picture.read_bytes(), venue, camera),
                large_answer=get_request(server.url, _large_path(server.url, venue)),
                workers=workers,
                seconds=seconds,
                times=times,
                gone=gone,
                slow=slow,
            )
            seen = asyncio.run(measured(server, load))
    shown = Shown()
    shown.table(_table(seen))
    shown.write("overload", figures)


async def measured(server: ServerProcess, load: Load) -> dict[str, Observed]:
    """Return what was seen under each load, by its name."""
    found: dict[str, Observed] = {}
    clients = FULL_RATIO * load.workers
    async with observing(server.url, server.pid) as seen:
        await clients_in_turn(seen, server.url, load.request, clients, WARM_S)
    if not seen.goodput:
        raise InvalidInputError("The server answered no query: is the venue right?")
    async with observing(server.url, server.pid) as found["busy"]:
        await clients_in_turn(found["busy"], server.url, load.request, clients, load.seconds)
    rate = load.times * found["busy"].goodput
    async with observing(server.url, server.pid) as found[f"{load.times:g} times as much"]:
        await at_a_rate(found[f"{load.times:g} times as much"], server.url, load.request, rate, load.seconds)
    name = f"{load.gone} clients go away"
    async with observing(server.url, server.pid) as found[name]:
        await asyncio.gather(
            clients_in_turn(found[name], server.url, load.request, clients, load.seconds),
            go_away(server.url, load.request, load.gone, 0.9 * load.seconds),
        )
    name, is_over = f"{load.slow} read slowly", asyncio.Event()
    async with observing(server.url, server.pid) as found[name]:
        reading = asyncio.create_task(read_slowly(server.url, load.large_answer, load.slow, is_over.is_set))
        await clients_in_turn(found[name], server.url, load.request, clients, load.seconds)
        is_over.set()
        await reading
    return found


def _large_path(url: str, venue: str) -> str:
    with httpx.Client(base_url=url) as client:
        versions = client.get(f"/venues/{venue}/maps").json()
    if not versions or not isinstance(versions, list):
        raise InvalidInputError(f"Venue {venue} has no map in this data folder.")
    return f"/venues/{venue}/maps/{versions[0]['version']}/points"


def _table(seen: dict[str, Observed]) -> Table:
    table = Table("load", *seen)
    best = next(iter(seen.values())).goodput
    first_mb = np.median(next(iter(seen.values())).memory_bytes) / 1e6
    rows = {
        "requests": [f"{len(each.answers):,}" for each in seen.values()],
        "answered, a second": [f"{each.goodput:.2f}" for each in seen.values()],
        "answered, of busy": [f"{each.goodput / best:.2f}" for each in seen.values()],
        "503": [f"{len(each.of_status(503)):,}" for each in seen.values()],
        "other answers": [
            str(sum(answer.status not in (200, 503) for answer in each.answers)) for each in seen.values()
        ],
        "503, ms: median, 95 %, 99 %, largest": [_spread_ms(each.of_status(503)) for each in seen.values()],
        "health, ms: median, 95 %, 99 %, largest": [
            _spread_ms([answer.seconds for answer in each.health]) for each in seen.values()
        ],
        "memory, MB: smallest, median, largest": [_memory_mb(each) for each in seen.values()],
        "largest memory, of the median of busy": [
            f"{_largest_mb(each) / first_mb:.2f}" for each in seen.values()
        ],
        "memory, last quarter over first": [f"{_growth(each):.2f}" for each in seen.values()],
    }
    for name, cells in rows.items():
        table.add_row(name, *cells)
    return table


def _memory_mb(seen: Observed) -> str:
    """Return the spread of resident memory over a whole load."""
    return ", ".join(f"{value / 1e6:.0f}" for value in np.percentile(seen.memory_bytes, [0, 50, 100]))


def _largest_mb(seen: Observed) -> float:
    return max(seen.memory_bytes) / 1e6


def _growth(seen: Observed) -> float:
    """Return the median memory of the last quarter of a load over that of the first."""
    quarter = max(1, len(seen.memory_bytes) // 4)
    return float(np.median(seen.memory_bytes[-quarter:]) / np.median(seen.memory_bytes[:quarter]))


def _spread_ms(seconds: list[float]) -> str:
    if not seconds:
        return "-"
    return ", ".join(f"{1e3 * value:.0f}" for value in np.percentile(seconds, [50, 95, 99, 100]))
