"""`roomfix evaluate-alignment`: the studio's Align view in Chromium, on the demonstration venue."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Annotated

import httpx
import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from bench.commands.demo import DEFAULT_DIR
from bench.demo import VENUE, WING_ROOMS, floor_plans
from bench.figures.shown import FiguresTitle, Shown
from bench.pages.alignment import PAIR_ZOOMS, AlignPage, Hands, Misalignment, Site, worst
from bench.pages.browser import browser_page
from bench.server_process import server_process
from bench.venue.layout import room_by_id

# Below the ceilings, so that walls are seen from above.
Z_MAX_M = 2.0
START_SHIFT_M = 5.0
# Corners where rooms of the scan meet, in world metres: the first near the middle, the others far apart.
MARKS_M = ((10.0, 17.0), (20.9, 25.9), (0.1, 0.1), (0.1, 25.9))


def evaluate_alignment(
    data_dir: Annotated[Path, typer.Option(help="The folder of `roomfix demo`.")] = DEFAULT_DIR,
    seeds: Annotated[
        int, typer.Option(min=1, help="How many hands try it, each from another beginning.")
    ] = 5,
    picture: Annotated[Path | None, typer.Option(help="Write a picture of the page here.")] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Lay the demonstration scan over its plan in the studio, with a hand that errs by 1 to 2 pixels of the screen."""
    with tempfile.TemporaryDirectory() as folder, progress_bars() as bars:
        copy = copied(data_dir, Path(folder) / "data")
        with server_process(copy, Path(folder) / "log") as server, browser_page() as page:
            hands = []
            for seed in range(seeds):
                hands.append(AlignPage(page, demo_site(server.url), seed).work())
                bars.report("align", seed + 1, seeds)
            if picture is not None:
                page.screenshot(path=picture)
    shown = Shown()
    shown.table(_table(hands))
    shown.line(
        "Largest: the farthest corner of the scanned rooms; mean: over these corners. The scan begins at any angle, "
        f"up to {START_SHIFT_M:.0f} m off in x and in y and up to 10 % too large or too small. Pairs are clicked at "
        f"{len(MARKS_M)} corners of rooms, with the whole plan in view (1) and closer."
    )
    shown.write("evaluate-alignment", figures_title)


def copied(data_dir: Path, to: Path) -> Path:
    """Copy what a server needs of a data folder, which may be in use."""
    to.mkdir(parents=True)
    source = f"file:{(data_dir / 'roomfix.db').resolve()}?mode=ro"
    with (
        closing(sqlite3.connect(source, uri=True)) as database,
        closing(sqlite3.connect(to / "roomfix.db")) as new,
    ):
        database.backup(new)
    shutil.copytree(data_dir / "blobs", to / "blobs")
    return to


def demo_site(address: str) -> Site:
    """Return the ground floor of the demonstration venue, as it was scanned."""
    floor = floor_plans()[0]
    venue = httpx.get(f"{address}/venues/{VENUE.id}").raise_for_status().json()
    bounds = np.array([room_by_id(name).bounds for name in WING_ROOMS])
    corners = np.concatenate([bounds[:, [u, v]] for u in (0, 2) for v in (1, 3)])
    return Site(
        address=address,
        venue=VENUE.id,
        floor=floor.id,
        version=venue["map_version"],
        truth=floor.plan_from_world[:2, [0, 1, 3]],
        marks=np.array(MARKS_M),
        corners=np.unique(corners, axis=0),
        z_max_m=Z_MAX_M,
        start_shift_m=START_SHIFT_M,
    )


def _table(hands: list[Hands]) -> Table:
    columns = ("largest m", "mean m", "degrees", "size %")
    table = Table("hand", "how", *columns)
    rows = {"dragged alone": [each.dragged for each in hands]}
    for zoom in PAIR_ZOOMS:
        rows[f"pairs, zoomed in {zoom:.0f} times"] = [each.paired[zoom] for each in hands]
    for how, results in rows.items():
        for seed, result in enumerate(results):
            table.add_row(str(seed), how, *_cells(result))
        table.add_row("worst", how, *_cells(worst(results)))
    return table


def _cells(result: Misalignment) -> tuple[str, ...]:
    return (
        f"{result.largest_m:.3f}",
        f"{result.mean_m:.3f}",
        f"{result.turn_deg:.2f}",
        f"{result.size_percent:.2f}",
    )
