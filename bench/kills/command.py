"""`roomfix kills`: servers and workers that are killed at random moments while clients build, edit and walk."""

from __future__ import annotations

import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import console
from app.errors import InvalidInputError
from bench.figures.shown import FiguresTitle, Shown
from bench.kills.clients import Sent
from bench.kills.run import Outcome, Site, run_kills
from bench.postgres import is_installed, postgres


def kills(
    scan: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="An archive that is built.")],
    picture: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="A JPEG that its map locates.")],
    camera: Annotated[str, typer.Option(help="fx,fy,cx,cy of the picture.")],
    options: Annotated[str, typer.Option(help="JSON options of the builds.")] = "{}",
    postgresql: Annotated[
        bool,
        typer.Option("--postgresql", help="Two servers and workers on a PostgreSQL server of their own."),
    ] = False,
    most: Annotated[int, typer.Option(min=1, help="Kills, unless the time is over before.")] = 200,
    minutes: Annotated[float, typer.Option(min=0.1, help="Time after which no more is killed.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the moments, and of what is killed.")] = 0,
    figures: FiguresTitle = None,
) -> None:
    """Kill servers or their workers at random moments while clients build, edit, push frames and walk; check each time
    that nothing acknowledged is lost."""
    if postgresql and not is_installed():
        raise InvalidInputError("There is no PostgreSQL server here, or no roomfix[postgresql].")
    sent = Sent(scan=scan.read_bytes(), options=options, picture=picture.read_bytes(), camera=camera)
    until = time.monotonic() + 60.0 * minutes

    def is_enough(number: int) -> bool:
        console.print(f"{number} kills", soft_wrap=True)
        return number >= most or time.monotonic() > until

    with tempfile.TemporaryDirectory() as folder, postgres() if postgresql else nullcontext() as database:
        data_dir, logs = Path(folder) / "data", Path(folder)
        site = Site(data_dir=data_dir, logs=logs, servers=2 if postgresql else 1, database_url=database)
        outcome = run_kills(site, sent, seed, is_enough)
    shown = Shown()
    shown.table(_table(outcome, site))
    for wrong in outcome.wrong:
        shown.line(f"- {wrong}")
    shown.write("kills", figures)


def _table(outcome: Outcome, site: Site) -> Table:
    kept, builds = outcome.kept, outcome.builds
    table = Table("what", "number")
    rows = {
        "database": "SQLite" if site.database_url is None else "PostgreSQL",
        "servers, each with a worker": site.servers,
        "kills of a server": outcome.kills["server"],
        "kills of a worker": outcome.kills["worker"],
        "servers started again": outcome.starts,
        "changes that were acknowledged": kept.changes,
        "of them builds": len(kept.builds),
        "builds that succeeded, each with a version of its own": builds["succeeded"],
        "builds ended by three deaths of their worker": builds["failed"],
        "sessions": len(kept.sessions),
        "lost, half visible or wrong": len(outcome.wrong),
    }
    for name, cell in rows.items():
        table.add_row(name, f"{cell:,}" if isinstance(cell, int) else cell)
    return table
