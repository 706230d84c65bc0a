"""`roomfix evaluate-twins`: look-alike floors of a building that decided no limit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from app.commands.build import build_scan, ensure_venue
from app.commands.console import BarProgress, progress_bars, settings_from
from app.engine.maps.open_map import OpenMap
from app.engine.maps.vision_models import VisionModels
from app.engine.query.localizer import Localizer
from app.errors import RoomfixError
from app.geometry.se3 import Pose
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from bench.evaluation.map_part import part_of_map
from bench.evaluation.pose_errors import GROSS_M
from bench.figures.shown import FiguresTitle, Shown
from bench.recordings.queries import DemoQuery, floor_of
from bench.twins.compare import LOOKS, Asked, compare_looks
from bench.twins.recordings import render_twin_queries, render_twin_scan

DEFAULT_DIR = Path(".roomfix/twins")
FLOORS = (0, 1)
FLOOR_NAMES = ("ground floor", "upper floor")


def evaluate_twins(
    building: Annotated[
        int, typer.Option(min=1, help="The number of the building: each has other pictures and textures.")
    ] = 2,
    count: Annotated[int, typer.Option(min=1, help="Pictures of each floor.")] = 100,
    every: Annotated[int, typer.Option(min=1, help="Ask one in this number of the pictures.")] = 1,
    data_dir: Annotated[Path, typer.Option(help="Folder for what is rendered and mapped.")] = DEFAULT_DIR,
    figures: FiguresTitle = None,
) -> None:
    """Locate pictures of corridors and lobbies in a map without their floor, which holds others that look like them."""
    folder = data_dir / str(building)
    resources = Resources.open(settings_from(data_dir=folder))
    try:
        with progress_bars() as progress:
            queries = _rendered(folder, building, count, resources.settings.workers, progress)
            opened = _mapped(resources, folder, f"twins-{building}", progress)
            asked = _asked(opened, resources.models, [each[::every] for each in queries], progress)
    finally:
        resources.close()
    shown = Shown()
    shown.table(_table(asked))
    shown.write("evaluate-twins", figures)


def _rendered(
    folder: Path, building: int, count: int, workers: int, progress: BarProgress
) -> list[list[DemoQuery]]:
    """Render the scan and the pictures of each floor, and return the pictures."""

    def reporter(stage: str) -> Callable[[int, int], None]:
        return lambda done, total: progress.report(stage, done, total)

    render_twin_scan(folder / "scan", building, workers, reporter("render the scan"))
    return [
        render_twin_queries(
            folder / f"queries-{floor}",
            building,
            floor,
            count,
            workers,
            reporter(f"pictures of floor {floor}"),
        )
        for floor in FLOORS
    ]


def _mapped(resources: Resources, folder: Path, venue: str, progress: BarProgress) -> OpenMap:
    """Return the map of the scan, which is built unless it is there."""
    ensure_venue(resources, venue, venue)
    library = MapLibrary(resources)
    if library.active(venue) is None:
        options = {
            "format": "tum",
            "world_from_scan": Pose.identity().matrix.tolist(),
            "second_features": True,
        }
        build_scan(resources, venue, folder / "scan", options, progress)
    serving = library.active(venue)
    if serving is None:
        raise RoomfixError("The map of the scan is not there.")
    return serving[0]


def _asked(
    opened: OpenMap, models: VisionModels, queries: Sequence[Sequence[DemoQuery]], progress: BarProgress
) -> list[Asked]:
    """Ask for each floor's pictures in a map of the other floor, where all answers are wrong, and in the whole map."""
    found = []
    for floor in FLOORS:
        other = 1 - floor
        name = f"{FLOOR_NAMES[floor]}, in a map of the {FLOOR_NAMES[other]} alone"
        part = Localizer(_floor_of_map(opened, models, other))
        found.append(compare_looks(name, part, queries[floor], progress, is_absent=True))
    everywhere = [query for floor in FLOORS for query in queries[floor]]
    found.append(
        compare_looks(
            "both floors, in a map of both", Localizer(opened), everywhere, progress, is_absent=False
        )
    )
    return found


def _floor_of_map(opened: OpenMap, models: VisionModels, floor: int) -> OpenMap:
    artifact = opened.artifact
    rows = [i for i in range(artifact.keyframe_count) if floor_of(artifact.pose(i)) == floor]
    part, index = part_of_map(artifact, opened.index, np.array(rows, np.int64), opened.extractor)
    return OpenMap.of(part, index, models)


def _table(asked: Sequence[Asked]) -> Table:
    table = Table("pictures", "look", "queries", "located", "right within 0.5 m", "wrong")
    for each in asked:
        for look in LOOKS:
            outcomes = each.outcomes[look]
            table.add_row(
                each.name,
                look,
                str(len(outcomes)),
                str(sum(outcome.located for outcome in outcomes)),
                "" if each.is_absent else str(sum(outcome.right for outcome in outcomes)),
                str(sum(outcome.located and outcome.position_m > GROSS_M for outcome in outcomes)),
            )
    return table
