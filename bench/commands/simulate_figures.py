"""`roomfix simulate-figures`: the figures of walks that were logged, be the simulation over or not."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import console
from app.errors import InvalidInputError
from bench.figures.shown import FiguresTitle, Shown
from bench.simulation.log import WalkLog
from bench.simulation.report import write_report
from bench.simulation.summary import (
    COLUMNS,
    THESIS_MEAN_M,
    THESIS_SUCCESS_PERCENT,
    Figures,
    Setting,
    figures_of,
)
from bench.simulation.walks import Outcome
from bench.venue.places import place_of

ByPlace = Annotated[
    bool,
    typer.Option("--by-place", help="Of the demonstration building: by the kind of place walked to, too."),
]


def simulate_figures(
    logs: Annotated[list[Path], typer.Argument(help="Files that `roomfix simulate --log` wrote.")],
    report: Annotated[Path | None, typer.Option(help="Write tables and plots into this folder.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
    by_place: ByPlace = False,
    figures_title: FiguresTitle = None,
) -> None:
    """Show the figures of logged walks together."""
    outcomes: dict[Setting, list[Outcome]] = {}
    for path in logs:
        if not path.exists():
            raise InvalidInputError(f"There is no file {path}: name what roomfix simulate --log wrote.")
        for setting, outcome in WalkLog(path).walks():
            outcomes.setdefault(setting, []).append(outcome)
    if not outcomes:
        raise InvalidInputError("No walk has ended yet: there are no figures.")
    figures = [row for setting, found in outcomes.items() for row in figures_of(setting, found)]
    shown = show_figures(figures, outcomes, report, json_file)
    if by_place:
        shown.table(_place_table(outcomes))
    shown.write("simulate", figures_title)


def show_figures(
    figures: Sequence[Figures],
    outcomes: Mapping[Setting, Sequence[Outcome]],
    report: Path | None,
    json_file: Path | None,
) -> Shown:
    """Print the table of figures, write report and file if they are asked for, and return what was printed."""
    shown = Shown()
    shown.table(_table(figures))
    if report is not None:
        console.print(f"Report: {write_report(report, figures, outcomes)}")
    if json_file is not None:
        trips = [{**asdict(setting), **asdict(one)} for setting, found in outcomes.items() for one in found]
        values = {"figures": [row.as_dict() for row in figures], "trips": trips}
        json_file.write_text(json.dumps(values, indent=1), encoding="utf-8")
    return shown


def _place_table(outcomes: Mapping[Setting, Sequence[Outcome]]) -> Table:
    columns = ("", "walked to", "runs", "successful %", "95 % interval", "mean error m")
    table = Table(*columns, title="by the kind of place that was the destination")
    for setting, found in outcomes.items():
        groups: dict[str, list[Outcome]] = {}
        for one in found:
            # A destination is named by floor and room.
            groups.setdefault(place_of(one.destination.partition(":")[2]), []).append(one)
        for place, some in sorted(groups.items()):
            row = figures_of(setting, some)[-1]
            mean = "-" if row.mean_error_m is None else f"{row.mean_error_m:g}"
            low, high = row.interval_percent
            table.add_row(
                setting.label, place, str(row.runs), f"{row.success_percent:g}", f"{low:g} to {high:g}", mean
            )
    return table


def _table(figures: Sequence[Figures]) -> Table:
    table = Table(title="walkers who follow guidance")
    for column in COLUMNS:
        table.add_column(column)
    for row in figures:
        table.add_row(*row.row(), end_section=row.length_m is None)
    thesis = ["thesis", "", "", "all", "", f"{THESIS_SUCCESS_PERCENT:g}", "", f"{THESIS_MEAN_M:g}"]
    table.add_row(*thesis, *[""] * (len(COLUMNS) - len(thesis)))
    return table
