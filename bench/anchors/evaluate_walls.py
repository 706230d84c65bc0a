"""`roomfix evaluate-walls`: what the walls of a floor plan add to monitoring cameras with few POIs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.services.resources import cap_threads
from bench.anchors.hung import HungOutcome, hung_pairs, locate_pair
from bench.figures.shown import FiguresTitle, Shown
from bench.render.noise import building
from bench.render.scene import Building, scene_of

# An answer is wrong that is off by more than both.
WRONG_M = 1.0
WRONG_SIGMAS = 3.0
HEAD = (
    "scale by", "phones", "located %", "mean m", "median m", "90 % m", "wrong by 3 sigmas, 1 m",
    "scale off by %, median", "90 %", "stated sigma %, median", "scale error in its sigmas, median", "90 % ", "99 %",
)  # fmt: skip


def evaluate_walls(
    number: Annotated[
        int,
        typer.Option(
            "--building", min=0, help="Pictures and textures of the building; 0: the demonstration's."
        ),
    ] = 1,
    pois: Annotated[int, typer.Option(min=1, max=4, help="Largest number of POIs of each camera.")] = 1,
    phones: Annotated[int, typer.Option(min=1, help="Phones around each camera.")] = 10,
    seed: Annotated[int, typer.Option(help="Where the phones are.")] = 1,
    figures_title: FiguresTitle = None,
) -> None:
    """Locate phones anywhere around cameras that an operator hung, by POIs alone and by the floor plan's walls too."""
    cap_threads()
    alone: list[HungOutcome] = []
    walls: list[HungOutcome] = []
    with building(number), progress_bars() as progress:
        for pair in hung_pairs(
            scene_of(Building(number)), pois, phones, seed, partial(progress.report, "phones")
        ):
            alone.append(locate_pair(pair, with_walls=False))
            walls.append(locate_pair(pair, with_walls=True))
    table = Table(
        *HEAD, title=f"building {number}, up to {pois} POIs a camera, {phones} phones each, seed {seed}"
    )
    table.add_row("POIs", *_cells(alone))
    table.add_row("POIs, walls and floor", *_cells(walls))
    table.add_row("of these: no POI seen", *_cells([one for one in walls if not one.has_poi]))
    shown = Shown()
    shown.table(table)
    shown.write("evaluate-walls", figures_title)


def _cells(outcomes: Sequence[HungOutcome]) -> tuple[str, ...]:
    located = [one for one in outcomes if one.reason is None]
    if not located:
        return str(len(outcomes)), "0", *["-"] * (len(HEAD) - 3)
    errors = np.array([one.error_m for one in located])
    sigmas = np.array([one.sigma_m for one in located])
    scales = np.abs([one.scale_error for one in located])
    stated = np.array([one.scale_sigma for one in located])
    beyond = (errors > WRONG_M) & (errors > WRONG_SIGMAS * sigmas)
    return (
        str(len(outcomes)),
        f"{100 * len(located) / len(outcomes):.1f}",
        *(f"{value:.2f}" for value in (errors.mean(), *np.percentile(errors, [50, 90]))),
        str(int(beyond.sum())),
        *(f"{100 * value:.1f}" for value in (*np.percentile(scales, [50, 90]), np.median(stated))),
        *(f"{value:.2f}" for value in np.percentile(scales / stated, [50, 90, 99])),
    )
