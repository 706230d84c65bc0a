"""`roomfix evaluate-rooms`: real rooms, several splits of each, several pipelines."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import progress_bars
from app.errors import InvalidInputError
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.evaluation.variations import VARIATIONS, parse_variations
from bench.figures.shown import FiguresTitle, Shown
from bench.rooms.compare import PIPELINES, Comparison, compare_room
from bench.rooms.measured import MeasuredResults
from bench.rooms.rooms import KINDS, Room, rooms_in
from bench.rooms.tables import rooms_table, splits_table, totals_table


def evaluate_rooms(
    data: Annotated[Path, typer.Argument(exists=True, file_okay=False, help="The folder of the rooms.")],
    room: Annotated[
        list[str] | None, typer.Option(help="A room; repeat it for several; default all.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(help=f"One of {', '.join(KINDS)}; repeat it for several; default all.")
    ] = None,
    pipeline: Annotated[
        list[str] | None,
        typer.Option(help=f"One of {', '.join(PIPELINES)}; repeat it for several; default all."),
    ] = None,
    degrade: Annotated[
        list[str] | None,
        typer.Option(help=f"Queries made worse: all, {', '.join(VARIATIONS)}; repeat it for several."),
    ] = None,
    queries: Annotated[
        int, typer.Option(min=0, help="Most queries of a split, evenly spread; 0 for all of them.")
    ] = 0,
    minutes: Annotated[
        float | None,
        typer.Option(min=0, help="Stop after this time; the same command with the same --json goes on."),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="Write all figures to this file, and leave out what it holds already."),
    ] = None,
    figures: FiguresTitle = None,
) -> None:
    """Locate the queries of every split of real rooms with every pipeline, and compare with the truth."""
    cap_threads()
    pipelines = pipeline or list(PIPELINES)
    for name in pipelines:
        if name not in PIPELINES:
            raise InvalidInputError(f"Pipeline {name!r} is not known; use {', '.join(PIPELINES)}.")
    rooms, measured = rooms_in(data, room or [], kind or []), MeasuredResults.of_file(json_file)
    wanted = Comparison(
        pipelines=pipelines,
        variations=parse_variations(degrade or []),
        queries=queries,
        known={each.key for each in measured.results},
    )
    is_whole = _measure(data, rooms, wanted, measured, None if minutes is None else 60.0 * minutes)
    shown = Shown()
    shown.table(splits_table(measured.results))
    shown.table(totals_table(measured.results))
    shown.table(rooms_table(rooms))
    if is_whole:
        shown.write("unseen", figures)
    else:
        shown.line("Not everything is measured yet: run the same command again.")


def _measure(
    data: Path, rooms: Sequence[Room], wanted: Comparison, measured: MeasuredResults, most_s: float | None
) -> bool:
    """Measure what is not known yet, and return whether nothing is left; False when the time is up before."""
    started, models = time.monotonic(), open_models(Settings())
    left = sum(len(wanted.keys(each, split)) for each in rooms for split in each.splits)
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        for each in rooms:
            for result in compare_room(data, each, wanted, models, executor, progress):
                measured.add([result])
                left -= 1
                if most_s is not None and time.monotonic() - started > most_s:
                    return left == 0
    return True
