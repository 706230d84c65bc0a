"""`roomfix evaluate-drift`: a scan with drift added to its poses, before and after its loops are closed."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.options import parse_build_options
from app.geometry.se3 import position_difference_m
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Dataset, Options
from bench.drift.measure import DriftResult, close_with_drift, poses_of
from bench.evaluation.dataset import parse_range
from bench.figures.shown import FiguresTitle, Shown


def evaluate_drift(
    dataset: Dataset,
    frames: Annotated[str, typer.Option(help="Frames of the scan: start:stop:step.")] = ":",
    drift: Annotated[
        list[float] | None, typer.Option(help="Drift in percent of the way; repeat it for several.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Draws of each drift.")] = 1,
    options: Options = "{}",
    figures_title: FiguresTitle = None,
) -> None:
    """Add drift to the poses of a scan, close its loops, and compare the positions with those before the drift."""
    cap_threads()
    base = parse_build_options(json.loads(options))
    scan = open_scan(dataset, base.format, base.scan)
    scan = replace(scan, frames=scan.frames[parse_range(frames)])
    rows: list[DriftResult] = []
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        models = open_models(Settings())
        for percent in drift or [0.0, 1.0]:
            for seed in range(seeds if percent else 1):
                rows.append(close_with_drift(scan, percent / 100, seed, models, executor, progress))
    way_m = sum(position_difference_m(a, b) for a, b in pairwise(poses_of(scan)))
    shown = Shown()
    shown.line(f"{len(scan.frames)} frames, {way_m:.0f} m of way.")
    shown.table(drift_table(rows))
    shown.write("evaluate-drift", figures_title)


def drift_table(results: list[DriftResult]) -> Table:
    """Return the table of the results."""
    columns = (
        "drift %",
        "draw",
        "pairs",
        "loops",
        "held back",
        "their error cm",
        "after cm",
        "applied",
        "position error cm",
        "after cm ",
        "left %",
    )
    table = Table(*columns, title="Positions before and after loop closure")
    for each in results:
        table.add_row(*_cells(each))
    return table


def _cells(each: DriftResult) -> list[str]:
    closed = each.closed
    return [
        f"{100 * each.drift_ratio:g}",
        str(each.seed),
        str(closed.compared),
        str(closed.loops),
        str(closed.held),
        _cm(closed.before_m),
        _cm(closed.after_m),
        "yes" if closed.is_applied else "no",
        _cm(each.before_m),
        _cm(each.after_m),
        f"{100 * each.after_m / each.before_m:.0f}" if each.drift_ratio else "none",
    ]


def _cm(length_m: float | None) -> str:
    return "none" if length_m is None else f"{100 * length_m:.2f}"
