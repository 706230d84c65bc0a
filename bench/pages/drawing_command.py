"""`roomfix measure-plan-drawing`: the pages' own drawing of a plan against MapLibre's, in Chromium."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from bench.figures.shown import FiguresTitle, Shown
from bench.pages.browser import browser_page
from bench.pages.plan_drawing import Load, drawings_served, measure_load

# A browser without a graphics card draws WebGL by the processor.
WEBGL_FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
SIZE_PX = (1280, 900)


def measure_plan_drawing(
    maplibre: Annotated[
        Path | None,
        typer.Option(help="The folder of npm's package maplibre-gl; default: the pages' own alone."),
    ] = None,
    loads: Annotated[int, typer.Option(min=1, help="How often each page is loaded.")] = 5,
    slower: Annotated[float, typer.Option(min=1, help="How many times slower the processor is made.")] = 4,
    seconds: Annotated[
        float, typer.Option(min=1, help="How long the dot moves, and the plan is pushed.")
    ] = 5,
    pictures: Annotated[
        Path | None, typer.Option(help="Write a picture of each page into this folder.")
    ] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Draw the demonstration venue's plan by the pages' own modules and by MapLibre: bytes, time, script by frame."""
    pages = {"own": "own.html"}
    if maplibre is not None:
        version = json.loads((maplibre / "package.json").read_text(encoding="utf-8"))["version"]
        pages[f"MapLibre {version}"] = "maplibre.html"
    measured: dict[str, list[Load]] = {name: [] for name in pages}
    sizes: dict[str, dict[str, int]] = {}
    with drawings_served(maplibre) as served, progress_bars() as bars:
        for number in range(loads):
            for name, file in pages.items():
                served.sizes.clear()
                shot = pictures / f"{file}.png" if pictures else None
                with browser_page(*WEBGL_FLAGS, width=SIZE_PX[0], height=SIZE_PX[1]) as page:
                    url = f"{served.address}/{file}"
                    load = measure_load(page, url, slower=slower, seconds=seconds, picture=shot)
                measured[name].append(load)
                sizes[name] = dict(served.sizes)
            bars.report("load", number + 1, loads)
    shown = Shown()
    shown.table(_table(measured, sizes))
    complaints = {each for all_ in measured.values() for load in all_ for each in load.complaints}
    for complaint in sorted(complaints):
        shown.line(f"The browser said: {complaint}")
    shown.write("measure-plan-drawing", figures_title)


def _table(measured: dict[str, list[Load]], sizes: dict[str, dict[str, int]]) -> Table:
    table = Table(
        "drawn by", "kB sent", "files", "plan drawn ms", "script ms a move", "main thread ms a move",
        "script ms a frame", "main thread ms a frame", "frames a second",
    )  # fmt: skip
    for name, loads in measured.items():
        figures = [
            (
                load.drawn_ms,
                load.move_script_ms,
                load.move_task_ms,
                load.pan_script_ms,
                load.pan_task_ms,
                load.pan_frames_s,
            )
            for load in loads
        ]
        drawn, *work, frames = np.median(figures, axis=0)
        sent_kb = sum(sizes[name].values()) / 1000
        cells = [
            f"{sent_kb:.0f}",
            str(len(sizes[name])),
            f"{drawn:.0f}",
            *(f"{value:.1f}" for value in work),
            f"{frames:.0f}",
        ]
        table.add_row(name, *cells)
    return table
