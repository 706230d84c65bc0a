"""`roomfix evaluate-rooms`: real rooms, several splits of each, several pipelines."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.errors import InvalidInputError
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.evaluation.variations import VARIATIONS, parse_variations
from bench.figures.shown import FiguresTitle, Shown
from bench.rooms.compare import ONE_LOOK, OURS, PIPELINES, RoomResult, compare_room
from bench.rooms.rooms import rooms_in


def evaluate_rooms(
    data: Annotated[Path, typer.Argument(exists=True, file_okay=False, help="The folder of the rooms.")],
    room: Annotated[
        list[str] | None, typer.Option(help="A room; repeat it for several; default all.")
    ] = None,
    pipeline: Annotated[
        list[str] | None,
        typer.Option(help=f"One of {', '.join(PIPELINES)}; repeat it for several; default all."),
    ] = None,
    degrade: Annotated[
        list[str] | None,
        typer.Option(help=f"Queries made worse: all, {', '.join(VARIATIONS)}; repeat it for several."),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Ask one in this number of a split's queries.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
    figures: FiguresTitle = None,
) -> None:
    """Locate the queries of every split of real rooms with every pipeline, and compare with the truth."""
    cap_threads()
    pipelines = pipeline or list(PIPELINES)
    for name in pipelines:
        if name not in PIPELINES:
            raise InvalidInputError(f"Pipeline {name!r} is not known; use {', '.join(PIPELINES)}.")
    rooms, variations, models = (
        rooms_in(data, room or []),
        parse_variations(degrade or []),
        open_models(Settings()),
    )
    results: list[RoomResult] = []
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        for each in rooms:
            results += compare_room(data, each, pipelines, variations, models, executor, progress, every)
    shown = Shown()
    shown.table(_splits_table(results))
    shown.table(_totals_table(results))
    shown.write("unseen", figures)
    if json_file is not None:
        json_file.write_text(json.dumps([each.as_dict() for each in results], indent=1, allow_nan=False))


COLUMNS = (
    "queries",
    "located and right %",
    "within 5 cm %",
    "wrong by 0.5 m %",
    "median cm",
    "right poses refused",
)


def _splits_table(results: Sequence[RoomResult]) -> Table:
    table = Table("room", "split: map / queries", "keyframes", "queries are", "pipeline", *COLUMNS)
    for each in results:
        table.add_row(
            each.room, each.split, str(each.keyframes), each.variation, each.pipeline, *_cells([each])
        )
    return table


def _totals_table(results: Sequence[RoomResult]) -> Table:
    table = Table("all rooms", "queries are", "pipeline", *COLUMNS)
    kinds = list(dict.fromkeys((each.kind, each.variation, each.pipeline) for each in results))
    for kind, variation, pipeline in sorted(kinds, key=lambda key: key[0]):
        chosen = [r for r in results if (r.kind, r.variation, r.pipeline) == (kind, variation, pipeline)]
        table.add_row(kind, variation, pipeline, *_cells(chosen))
    return table


def _cells(results: Sequence[RoomResult]) -> list[str]:
    """Return what the columns say of results together."""
    queries = sum(len(each.outcomes) for each in results)

    def percent(count: int) -> str:
        return f"{100 * count / queries:.1f}"

    ours = results[0].pipeline in (OURS, ONE_LOOK)
    refused = f"{sum(r.right_refused for r in results)} of {sum(r.refused for r in results)}"
    return [
        str(queries),
        percent(sum(each.right for each in results)),
        percent(sum(each.within_5cm for each in results)),
        percent(sum(each.wrong for each in results)),
        str(results[0].median_cm) if len(results) == 1 else "",
        refused if ours else "",
    ]
