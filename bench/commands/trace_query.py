"""`roomfix trace-query`: the way of queries through the modules of the product."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import DataDir, console, settings_from
from app.geometry.camera_hint import parse_camera_hint
from app.services.locate_result import LocateRequest
from app.services.resources import Resources
from app.services.wiring import wire_services
from bench.evaluation.call_path import CallPath, trace
from bench.figures.provenance import ROOT, commit_of
from bench.figures.shown import FiguresTitle, Shown

JsonFile = Annotated[
    Path | None,
    typer.Option("--json", dir_okay=False, help="Write the returns and this commit to a file, for --before."),
]
BeforeFile = Annotated[
    Path | None,
    typer.Option(
        "--before",
        exists=True,
        dir_okay=False,
        help="A file of --json: the returns of another commit beside.",
    ),
]


def trace_query(
    images: Annotated[list[Path], typer.Argument(exists=True, dir_okay=False, help="Photos of the venue.")],
    venue: Annotated[str | None, typer.Option(help="The venue, if there are several.")] = None,
    camera: Annotated[str | None, typer.Option(help="fx,fy,cx,cy, searched for if not given.")] = None,
    data_dir: DataDir = None,
    path: Annotated[bool, typer.Option("--path", help="Print every stay, in order.")] = False,
    before: BeforeFile = None,
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Locate photos twice and print the second time's stays in modules, and returns to modules already left."""
    found: dict[str, CallPath] = {}
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        service = wire_services(resources).locate
        for image in images:
            request = LocateRequest(image=image.read_bytes(), venue=venue, camera=parse_camera_hint(camera))
            service.locate(request)
            found[image.name] = trace(partial(service.locate, request))
    finally:
        resources.close()
    if path:
        console.print("\n".join(stay for each in found.values() for stay in each.stays))
    shown = Shown()
    shown.table(table_of(found, before))
    shown.write("trace-query", figures_title)
    if json_file is not None:
        written = {
            "commit": commit_of(ROOT).strip("`"),
            "returns": {name: each.returns for name, each in found.items()},
        }
        json_file.write_text(json.dumps(written, indent=1), encoding="utf-8")


def table_of(found: dict[str, CallPath], before: Path | None = None) -> Table:
    """Return a row for each photo; `before` is a file of `--json`, whose returns stand in a column more."""
    old = None if before is None else json.loads(before.read_text(encoding="utf-8"))
    table = Table("photo", "modules", "stays", "returns to a module already left")
    if old is not None:
        table.add_column(f"returns at `{old['commit']}`")
    for name, each in found.items():
        beside = [] if old is None else [str(old["returns"].get(name, ""))]
        table.add_row(name, str(each.modules), str(len(each.stays)), str(each.returns), *beside)
    return table
