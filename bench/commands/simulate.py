"""`roomfix simulate`: walkers in the demonstration venue who follow nothing but guidance."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import console, progress_bars, settings_from
from app.errors import InvalidInputError
from app.services.resources import cap_threads
from bench.commands.demo import DEFAULT_DIR
from bench.commands.simulate_figures import show_figures
from bench.figures.shown import FiguresTitle
from bench.simulation.log import WalkLog
from bench.simulation.summary import (
    Setting,
    figures_of,
    floor_line,
)
from bench.simulation.walks import SILENCE_S, Outcome

KINDS = ("on", "lost", "off")


NoMap = Annotated[
    bool,
    typer.Option(
        "--no-map", help="No scan at all: floor plans, and monitoring cameras as an operator hangs them."
    ),
]
AnchorsDir = Annotated[
    Path | None,
    typer.Option(
        help="Folder for these cameras' anchors, made at the first use; by default inside --data-dir."
    ),
]


def simulate(
    data_dir: Annotated[Path, typer.Option(help="The folder of `roomfix demo --whole`.")] = DEFAULT_DIR,
    runs: Annotated[int, typer.Option(min=1, help="Trips for each setting, the lengths in turn.")] = 40,
    lengths: Annotated[str, typer.Option(help="Lengths of the routes, metres, with commas.")] = "20,40,60,80",
    relocation: Annotated[
        str,
        typer.Option(
            help="Use of the map after the first fix: on, lost (only when odometry is), off; commas."
        ),
    ] = "on,off",
    fps: Annotated[str, typer.Option(help="Frames a second, with commas.")] = "4",
    light: Annotated[str, typer.Option(help="Light as a share of the day's, with commas.")] = "1",
    width: Annotated[int, typer.Option(min=160, max=1920, help="Width of the pictures, pixels.")] = 400,
    no_map: NoMap = False,
    anchors: AnchorsDir = None,
    pois: Annotated[int, typer.Option(min=1, max=4, help="Largest number of POIs of each of them.")] = 4,
    from_floor: Annotated[
        int | None, typer.Option(help="Begin all trips on this floor, scanned or not.")
    ] = None,
    silence: Annotated[
        float, typer.Option(min=1.0, help="Seconds without guidance after which a walker is lost.")
    ] = SILENCE_S,
    seed: Annotated[int, typer.Option(help="What chance comes from: the same seed, the same trips.")] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    log: Annotated[
        Path | None,
        typer.Option(help="Add each walk to this file as it ends, and don't walk again what it holds."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write tables and plots into this folder.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Let walkers follow guidance through the demonstration venue, and count who arrives."""
    settings_of = [
        Setting(kind, rate, share, no_map)
        for kind in _kinds(relocation)
        for rate in _numbers(fps, "fps", 0.5, 30.0)
        for share in _numbers(light, "light", 0.05, 3.0)
    ]
    wanted = _numbers(lengths, "lengths", 5.0, 500.0)
    folder = _cameras(anchors or data_dir / f"cameras-{pois}", pois) if no_map else data_dir
    walks = Walks(
        settings_of=settings_of,
        lengths=wanted,
        runs=runs,
        width=width,
        seed=seed,
        workers=workers,
        from_floor=from_floor,
        silence_s=silence,
    )
    outcomes = _walk(folder, walks, WalkLog(log))
    figures = [row for setting in settings_of for row in figures_of(setting, outcomes[setting])]
    shown = show_figures(figures, outcomes, report, json_file)
    if from_floor is not None:
        shown.line(floor_line(from_floor, [one for found in outcomes.values() for one in found]))
    shown.write("simulate", figures_title)


def _cameras(folder: Path, pois: int) -> Path:
    """Return the folder of the venue with monitoring cameras and no map, filled at its first use."""
    from bench.render.scene import demo_scene
    from bench.simulation.no_map import prepare_without_map

    cap_threads()
    count = prepare_without_map(settings_from(data_dir=folder), demo_scene(), pois)
    console.print(f"{count} monitoring cameras with up to {pois} POIs each, and no map.")
    return folder


@dataclass(frozen=True, slots=True, kw_only=True)
class Walks:
    """Which walks are walked, and how."""

    settings_of: list[Setting]
    lengths: list[float]
    runs: int
    width: int
    seed: int
    workers: int
    from_floor: int | None
    silence_s: float


def _walk(data_dir: Path, walks: Walks, log: WalkLog) -> dict[Setting, list[Outcome]]:
    from bench.render.scene import demo_scene
    from bench.simulation.runs import Job, Place, choose_trips, run_jobs

    cap_threads()
    settings = settings_from(data_dir=data_dir)
    place = Place.open(settings, walks.settings_of[0].no_map)
    try:
        trips = choose_trips(place, walks.lengths, walks.runs, walks.seed, walks.from_floor)
    finally:
        place.resources.close()
    jobs = [
        Job(setting, trip, walks.seed, walks.silence_s) for setting in walks.settings_of for trip in trips
    ]
    with tempfile.TemporaryDirectory() as folder, progress_bars() as progress:
        demo_scene().save(Path(folder))
        demo_scene.cache_clear()
        found = run_jobs(
            settings,
            Path(folder),
            walks.width,
            jobs,
            walks.workers,
            lambda done, total: progress.report("walk", done, total),
            log,
        )
    return {
        setting: found[row * len(trips) : (row + 1) * len(trips)]
        for row, setting in enumerate(walks.settings_of)
    }


def _kinds(text: str) -> list[str]:
    kinds = list(dict.fromkeys(part.strip() for part in text.split(",")))
    if any(kind not in KINDS for kind in kinds):
        raise InvalidInputError(f"--relocation takes {', '.join(KINDS)}, one or several with commas.")
    return kinds


def _numbers(text: str, option: str, least: float, most: float) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(least <= value <= most for value in values):
        raise InvalidInputError(f"--{option} takes numbers from {least:g} to {most:g} with commas.")
    return list(dict.fromkeys(values))
