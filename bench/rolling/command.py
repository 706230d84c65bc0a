"""`roomfix rolling-restart`: what clients see while two servers on the same data are replaced one after the other."""

from __future__ import annotations

import asyncio
import math
import os
import tempfile
import threading
import time
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import httpx
import typer
from rich.table import Table

from app.commands.venue_file import export_venue
from app.errors import InvalidInputError, RoomfixError
from bench.figures.shown import FiguresTitle, Shown
from bench.overload.request import NO_ANSWER
from bench.postgres import is_installed, postgres
from bench.rolling.balancer import Balancer, balancing
from bench.rolling.clients import (
    Answers,
    Build,
    Seen,
    Used,
    ask_in_turn,
    ask_kept_alive,
    build,
    stream,
    upload,
    walk,
)
from bench.server_process import server_process

REPLICAS = 2
# Longer than the balancer needs to see that a server is not ready.
DRAIN_S = 2.0
# Between two replacements, when both servers answer.
BOTH_S = 3.0
# Before the first one.
CALM_S = 15.0
UPLOAD_BYTES = 100_000_000


@dataclass(slots=True, kw_only=True)
class Replicas:
    """The servers: what they share, and each with what stops it as SIGTERM does."""

    data_dir: Path
    logs: Path
    settings: dict[str, str]
    running: list[tuple[str, ExitStack]] = field(default_factory=list)
    started: int = 0

    def start(self) -> str:
        """Start one more, with its worker, and return its address."""
        stack = ExitStack()
        log = self.logs / f"log{self.started}"
        self.started += 1
        server = stack.enter_context(server_process(self.data_dir, log, **self.settings))
        self.running.append((server.url, stack))
        return server.url

    def stop_first(self) -> str:
        """Stop the one that runs longest and return its address."""
        url, stack = self.running.pop(0)
        stack.close()
        return url

    def count_in_logs(self, text: str) -> int:
        """Return how many lines of all servers' logs hold a text."""
        logs = [path.read_text(encoding="utf-8") for path in self.logs.glob("log*")]
        return sum(text in line for log in logs for line in log.splitlines())


def rolling_restart(
    data_dir: Annotated[Path, typer.Option(exists=True, file_okay=False, help="A data folder with a map.")],
    picture: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="A JPEG that the map locates.")],
    scan: Annotated[
        Path, typer.Option(exists=True, dir_okay=False, help="An archive that is built meanwhile.")
    ],
    options: Annotated[str, typer.Option(help="JSON options of its build.")] = "{}",
    venue: Annotated[str, typer.Option(help="The venue of the map.")] = "demo",
    camera: Annotated[str | None, typer.Option(help="fx,fy,cx,cy of the picture.")] = None,
    sqlite: Annotated[
        bool, typer.Option("--sqlite", help="SQLite even where a PostgreSQL server is installed.")
    ] = False,
    clients: Annotated[int, typer.Option(min=1, help="Clients of each kind.")] = 1,
    drain_s: Annotated[float, typer.Option(min=0, help="ROOMFIX_DRAIN_S of the servers.")] = DRAIN_S,
    finish_build_s: Annotated[
        float, typer.Option(min=0, help="ROOMFIX_FINISH_BUILD_S of their workers.")
    ] = 0.0,
    figures: FiguresTitle = None,
) -> None:
    """Replace two servers on a venue of a data folder, one after the other, behind a balancer and under load: queries,
    sessions, an upload and a build."""
    has_postgres = is_installed() and not sqlite
    with tempfile.TemporaryDirectory() as folder, postgres() if has_postgres else nullcontext() as database:
        sent = Path(folder) / "upload"
        sent.write_bytes(os.urandom(UPLOAD_BYTES))
        export_venue(venue, Path(folder) / "venue", active=True, data_dir=data_dir)
        settings = {
            "ROOMFIX_RUN_WORKER": "true",
            "ROOMFIX_DRAIN_S": str(drain_s),
            "ROOMFIX_FINISH_BUILD_S": str(finish_build_s),
        }
        settings |= {} if database is None else {"ROOMFIX_DATABASE_URL": database}
        use = Used(
            picture=picture.read_bytes(),
            scan=scan,
            options=options,
            venue=venue,
            camera=camera,
            upload=sent,
        )
        replicas = Replicas(data_dir=Path(folder) / "data", logs=Path(folder), settings=settings)
        seen, built = asyncio.run(measured(replicas, Path(folder) / "venue", use, clients))
        starts = replicas.count_in_logs(f"build {built.id} of venue")
    shown = Shown()
    shown.table(_answers_table(seen))
    shown.table(_table(seen, built, starts, "PostgreSQL" if has_postgres else "SQLite"))
    shown.write("rolling-restart", figures)


async def measured(replicas: Replicas, venue_file: Path, use: Used, clients: int) -> tuple[Seen, Build]:
    """Return what clients saw."""
    seen, is_over, all_replaced = Seen(), asyncio.Event(), threading.Event()
    try:
        async with balancing() as (url, balancer):
            for _ in range(REPLICAS):
                balancer.servers.append(await asyncio.to_thread(replicas.start))
            await balancer.check()
            await asyncio.to_thread(_import_venue, balancer.servers[0], venue_file)
            building = asyncio.create_task(build(url, use))
            sending = asyncio.create_task(upload(url, use, seen, replicas.data_dir, all_replaced))
            kinds = (ask_in_turn, ask_kept_alive, walk, stream)
            asking = [
                asyncio.create_task(kind(url, use, seen, is_over)) for kind in kinds for _ in range(clients)
            ]
            await asyncio.sleep(CALM_S)
            seen.replacing_from_s = time.perf_counter()
            await _replace_all(replicas, balancer)
            all_replaced.set()
            built = await building
            await sending
            is_over.set()
            await asyncio.gather(*asking)
    finally:
        all_replaced.set()
        for _, stack in replicas.running:
            await asyncio.to_thread(stack.close)
    return seen, built


async def _replace_all(replicas: Replicas, balancer: Balancer) -> None:
    """Replace each server: the new one starts before the old one stops, as in a rolling update."""
    for _ in range(REPLICAS):
        balancer.servers.append(await asyncio.to_thread(replicas.start))
        await balancer.check()
        balancer.servers.remove(await asyncio.to_thread(replicas.stop_first))
        await asyncio.sleep(BOTH_S)


def _import_venue(url: str, file: Path) -> None:
    with httpx.Client(base_url=url, timeout=600.0, trust_env=False) as client, file.open("rb") as archive:
        answer = client.post("/venues/import", files={"archive": archive})
    if answer.status_code != 201:
        raise RoomfixError(f"The venue could not be imported: {answer.text}")


def _answers_table(seen: Seen) -> Table:
    kinds: dict[str, Answers] = {
        "queries, a connection each": seen.queries,
        "queries, one connection": seen.kept_alive,
        "frames of sessions": seen.frames,
        "frames of streams": seen.streamed,
    }
    table = Table("answers", *kinds)
    if not all(each.statuses for each in kinds.values()):
        raise InvalidInputError("Some clients were not answered at all: are venue and picture right?")
    rows = {
        "requests": [len(each.statuses) for each in kinds.values()],
        "lost": [each.statuses.count(NO_ANSWER) for each in kinds.values()],
        "5xx": [sum(status >= 500 for status in each.statuses) for each in kinds.values()],
        "other than 200": [sum(status != 200 for status in each.statuses) for each in kinds.values()],
    }
    for name, cells in rows.items():
        table.add_row(name, *(f"{cell:,}" for cell in cells))
    gaps = {"longest gap, s": math.inf, "longest gap before the first was replaced, s": seen.replacing_from_s}
    for name, until_s in gaps.items():
        table.add_row(name, *(f"{each.longest_gap_s(until_s):.1f}" for each in kinds.values()))
    return table


def _table(seen: Seen, built: Build, starts: int, database: str) -> Table:
    table = Table("what", "value")
    rows = {
        "database": database,
        "servers replaced": str(REPLICAS),
        "sessions": str(seen.sessions),
        "sessions that went on, with every answered frame": str(seen.whole_sessions),
        "streams connected again": str(seen.reconnects),
        "upload arrived whole": "yes" if seen.is_upload_whole else "no",
        "requests that carried the upload": str(seen.upload_parts),
        "build": f"{built.state}, {built.error or 'no error'}",
        "times the build was started": str(starts),
        "attempts counted": str(built.attempts),
        "maps of the build's venue": str(built.maps),
    }
    for name, cell in rows.items():
        table.add_row(name, cell)
    return table
