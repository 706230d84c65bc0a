"""`roomfix large-maps`: what maps of many keyframes cost to open and to ask."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import errors, settings_from
from app.errors import ConflictError
from app.services.map_library import MapLibrary
from app.services.resources import Resources, cap_threads
from bench.figures.shown import FiguresTitle, Shown
from bench.large_maps.measure import Cost, measure
from bench.large_maps.tiling import Tiled, tile_map

MEASURE = "from bench.large_maps.command import measure_here; measure_here()"


def large_maps(
    data_dir: Annotated[Path, typer.Option(help="A data folder with a map.")],
    pictures: Annotated[Path, typer.Option(help="Folder of JPEG pictures to locate in the map.")],
    venue: Annotated[str, typer.Option(help="The venue of the map.")] = "demo",
    copies: Annotated[
        str, typer.Option(help="Numbers of copies of the map, one measurement each.")
    ] = "1,10,45",
    count: Annotated[int, typer.Option(help="Pictures that are located.")] = 20,
    scratch: Annotated[
        Path | None, typer.Option(help="Folder for the tiled maps, on a disk with room.")
    ] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Tile a map into larger ones whose parts have independent descriptors, and measure what they cost."""
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        serving = MapLibrary(resources).active(venue)
    finally:
        resources.close()
    if serving is None:
        raise ConflictError(f"Venue {venue} has no map.")
    artifact, index = serving[0].artifact, serving[0].index
    images = sorted(pictures.glob("*.jpg"))[:count]
    if scratch is not None:
        scratch.mkdir(parents=True, exist_ok=True)
    costs: list[Cost] = []
    made_s: list[float] = []
    for number in (int(each) for each in copies.split(",")):
        with tempfile.TemporaryDirectory(dir=scratch) as folder:
            began = time.perf_counter()
            tiled = tile_map(artifact, index, number, Path(folder))
            made_s.append(time.perf_counter() - began)
            costs.append(_measured(tiled, images))
            errors.print(costs[-1])
    shown = Shown()
    shown.table(_table(costs, made_s))
    shown.write("large-maps", figures_title)


def _measured(tiled: Tiled, images: list[Path]) -> Cost:
    """Measure a map in a process of its own, so that no memory of another one counts."""
    order = {
        "artifact": str(tiled.artifact_path),
        "index": str(tiled.index_path),
        "descriptors": str(tiled.artifact_path.with_name("descriptors")),
        "images": [str(path.resolve()) for path in images],
    }
    ended = subprocess.run(  # noqa: S603 - our own code
        [sys.executable, "-c", MEASURE], input=json.dumps(order).encode(), stdout=subprocess.PIPE, check=True
    )
    return Cost(**json.loads(ended.stdout))


def measure_here() -> None:
    """Measure by the order on standard input."""
    cap_threads()
    order = json.load(sys.stdin)
    images = [Path(path).read_bytes() for path in order["images"]]
    cost = measure(Path(order["artifact"]), Path(order["index"]), images, Path(order["descriptors"]))
    json.dump(asdict(cost), sys.stdout)


def _table(costs: list[Cost], made_s: list[float]) -> Table:
    table = Table("keyframes", *(f"{cost.keyframes:,}" for cost in costs))
    table.add_row("files, MB", *(f"{cost.file_mb:,.0f}" for cost in costs))
    table.add_row("written, s", *(f"{seconds:,.0f}" for seconds in made_s))
    table.add_row("opening, s", *(f"{cost.open_s:.3f}" for cost in costs))
    table.add_row("first query, ms of processor", *(f"{cost.first_query_ms:.0f}" for cost in costs))
    table.add_row("query, median ms of processor", *(f"{cost.query_ms:.0f}" for cost in costs))
    table.add_row("retrieval, median ms", *(f"{cost.retrieve_ms:.1f}" for cost in costs))
    table.add_row("located", *(f"{cost.located} of {cost.queries}" for cost in costs))
    table.add_row("own memory of the map, MB", *(f"{cost.own_mb:,.0f}" for cost in costs))
    table.add_row("mapped pages in memory, MB", *(f"{cost.mapped_mb:,.0f}" for cost in costs))
    table.add_row("recall@10 of retrieval", *(f"{cost.recall:.4f}" for cost in costs))
    return table
