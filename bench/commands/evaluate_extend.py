"""`roomfix evaluate-extend`: a map of two scans, registered to each other, against a map of one."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.options import parse_build_options
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Dataset, JsonFile, Options, Queries
from bench.evaluation.extend import ExtendEvaluation, evaluate_extension, split_for_extension
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.tables import ERROR_ROWS


def evaluate_extend(
    dataset: Dataset,
    first: Annotated[
        str, typer.Option(help="Frames of the first scan: start:stop:step, by order.")
    ] = "0:150",
    second: Annotated[str, typer.Option(help="Frames of the scan that extends the map.")] = "150:300",
    queries: Queries = "300::3",
    seed: Annotated[int, typer.Option(help="Of the frame that the second scan is moved to.")] = 0,
    options: Options = "{}",
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Extend a map by a scan in another frame, and compare with a map of one scan of both parts."""
    cap_threads()
    base = parse_build_options(json.loads(options))
    split = split_for_extension(dataset, first, second, queries, base.format, base.scan)
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        figures = evaluate_extension(split, base, open_models(Settings()), executor, progress, seed)
    shown = Shown()
    shown.table(_table(figures))
    shown.write("evaluate-extend", figures_title)
    if json_file is not None:
        json_file.write_text(json.dumps(figures.as_dict(), indent=1))


def _table(figures: ExtendEvaluation) -> Table:
    table = Table(
        "",
        *figures.summaries,
        title=f"registered {figures.registration_cm} cm, {figures.registration_deg} deg off: of {figures.tried} "
        f"frames {figures.located} located, {figures.agreeing} agree",
    )
    table.add_row("keyframes", *(str(count) for count in figures.keyframes.values()))
    for title, name in ERROR_ROWS.items():
        table.add_row(title, *(str(getattr(summary, name)) for summary in figures.summaries.values()))
    return table
