"""`roomfix evaluate-formats`: the same frames in every format that is read, and what their maps do."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Dataset, Options, Queries
from bench.evaluation.dataset import split_scan
from bench.figures.provenance import ROOT, commit_of
from bench.figures.shown import FiguresTitle, Shown
from bench.formats.evaluate import FormatQueries, FormatResult, evaluate_formats
from bench.formats.frames import written_scan
from bench.formats.writers import WRITERS

REFERENCE = "TUM"


def evaluate_formats_command(
    dataset: Dataset,
    database: Annotated[str, typer.Option(help="Frames that are written: start:stop:step.")] = "0:300:2",
    queries: Queries = "300::3",
    only: Annotated[list[str] | None, typer.Option(help="A format; repeat it for several.")] = None,
    options: Options = "{}",
    rows_file: Annotated[
        Path | None,
        typer.Option(
            "--json", help="Keep the rows here; formats with a row of an earlier run are not measured again."
        ),
    ] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Write frames of a scan in every format, build each file without any option, and locate the same queries."""
    cap_threads()
    unknown = [name for name in only or () if name not in WRITERS]
    if unknown:
        raise InvalidInputError(f"The format {unknown[0]!r} is not written; use one of {', '.join(WRITERS)}.")
    base = parse_build_options(json.loads(options))
    split = split_scan(dataset, database, queries, base.format, base.scan)
    down = base.gravity or split.database.gravity
    if down is None:
        raise InvalidInputError("The formats of phones say which way is down: give gravity in the options.")
    written = written_scan(split.database, down)
    rows = json.loads(rows_file.read_text()) if rows_file is not None and rows_file.is_file() else {}
    asked_for = [name for name in WRITERS if not only or name in only]
    writers = {name: WRITERS[name] for name in asked_for if name not in rows}
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        asked = FormatQueries(split.database, split.queries)
        for result in evaluate_formats(written, asked, writers, open_models(Settings()), executor, progress):
            rows[result.name] = _row(result)
            if rows_file is not None:
                rows_file.write_text(json.dumps(rows, indent=1))
    shown = Shown()
    shown.table(_table(rows))
    shown.write("evaluate-formats", figures_title)


def _row(result: FormatResult) -> dict[str, float | int | str]:
    summary = result.summary
    return {
        "MB": round(result.megabytes, 1),
        "frames": result.frames,
        "examination": result.verdict,
        "keyframes": result.keyframes,
        "build s": round(result.build_s),
        "located %": summary.located_percent,
        "median cm": summary.median_cm or "none",
        "p90 cm": summary.p90_cm or "none",
        "median deg": summary.median_deg or "none",
        "wrong %": summary.gross_percent,
        "commit": commit_of(ROOT).strip("`"),
    }


def _table(rows: dict[str, dict[str, float | int | str]]) -> Table:
    columns = list(next(iter(rows.values()), {}))
    table = Table("format", *columns, title="Maps of the same frames in each format")
    for name in WRITERS:
        if name in rows:
            table.add_row(name, *(str(rows[name][column]) for column in columns))
    return table
