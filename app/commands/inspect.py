"""`roomfix inspect`: what a scan holds and what a build would do with it."""

from __future__ import annotations

import json
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.commands.console import JsonFlag, console, json_object, progress_bars
from app.engine.mapping.options import parse_build_options
from app.errors import RoomfixError
from app.services.inspection.inspect_archive import inspect_sent
from app.services.resources import cap_threads
from app.settings import Settings


def inspect(
    scan: Annotated[Path, typer.Argument(exists=True, help="The scan: a folder, zip, tar or recording.")],
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    picture: Annotated[
        Path | None, typer.Option(help="Write the path from above to this file, as SVG.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Say what a scan holds and what a build would do with it; builds nothing."""
    cap_threads()
    parsed = parse_build_options(json_object(options))
    with (
        ThreadPoolExecutor(Settings().workers) as executor,
        progress_bars() as progress,
        tempfile.TemporaryDirectory(prefix="roomfix-inspect-") as folder,
    ):
        found = inspect_sent(scan, parsed, executor, progress, Path(folder))
    if picture is not None and found["path_svg"] is None:
        raise RoomfixError(
            "Pictures without poses have no path yet, so there is no picture of it: leave out --picture."
        )
    if picture is not None:
        picture.write_text(found["path_svg"], encoding="utf-8")
    if as_json:
        console.print_json(json.dumps(found))
        return
    show_inspection(found)


def show_inspection(found: dict[str, Any]) -> None:
    """Print an inspection as `POST /database/inspect` answers it."""
    console.print(_table(found))
    for finding in (found["examination"] or {}).get("findings", []):
        console.print(f"[yellow]{finding['sentence']}[/yellow]", soft_wrap=True)
    for note in found["notes"]:
        console.print(note, soft_wrap=True)


def _table(found: dict[str, Any]) -> Table:
    table = Table(show_header=False)
    verdict = (found["examination"] or {}).get("verdict", "not examined")
    for name in ("format", "frames", "discarded", "duration_s", "rate_hz"):
        table.add_row(name, json.dumps(found[name]))
    table.add_row("colour", json.dumps(found["sensors"]["color"]))
    table.add_row("depth", json.dumps(found["sensors"]["depth"]))
    table.add_row("trajectory", json.dumps(found["trajectory"]))
    table.add_row("examination", verdict)
    table.add_row("loops", json.dumps(found["loops"]))
    table.add_row("build", json.dumps(found["build"]))
    return table
