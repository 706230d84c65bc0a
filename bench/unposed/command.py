"""`roomfix evaluate-unposed`: maps of a scan's pictures as a video, as photos, and of its depth without poses."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from app.importers.frames import Scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Dataset, Options, Queries
from bench.evaluation.dataset import split_scan
from bench.figures.shown import FiguresTitle, Shown
from bench.formats.evaluate import FormatQueries
from bench.unposed.evaluate import Sent, UnposedResult, evaluate_unposed
from bench.unposed.inputs import (
    measured_distance,
    photo_name,
    plan_places,
    write_depth_frames,
    write_photos,
    write_video,
)

VIDEO = "video, one known distance"
PHOTOS = "photos, no scale"
PHOTOS_DISTANCE = "photos, one known distance"
PHOTOS_PLAN = "photos, places on the plan"
DEPTH = "colour and depth, no poses"
KINDS = (VIDEO, PHOTOS, PHOTOS_DISTANCE, PHOTOS_PLAN, DEPTH)


def evaluate_unposed_command(
    dataset: Dataset,
    database: Annotated[str, typer.Option(help="Frames that are written: start:stop:step.")] = "0:300",
    queries: Queries = "300::3",
    only: Annotated[list[str] | None, typer.Option(help="One of the rows; repeat it for several.")] = None,
    photos_every: Annotated[int, typer.Option(min=1, help="Every n-th of these frames is a photo.")] = 5,
    options: Options = "{}",
    figures_title: FiguresTitle = None,
) -> None:
    """Write frames of a scan without their poses, build maps of them, and locate the same queries."""
    cap_threads()
    unknown = [name for name in only or () if name not in KINDS]
    if unknown:
        raise InvalidInputError(f"There is no row {unknown[0]!r}; use one of {'; '.join(KINDS)}.")
    values = json.loads(options)
    base = parse_build_options(values)
    split = split_scan(dataset, database, queries, base.format, base.scan)
    gravity = base.gravity or split.database.gravity
    down = None if gravity is None else np.array(gravity)
    asked = FormatQueries(split.database, split.queries)
    rows: list[UnposedResult] = []
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        models = open_models(Settings())
        for kind in only or KINDS:
            with tempfile.TemporaryDirectory(prefix="roomfix-unposed-") as folder:
                sent = _sent(kind, split.database, values, down, photos_every, Path(folder))
                rows.append(
                    evaluate_unposed(
                        sent, split.database, down, asked, models, executor, progress, Path(folder)
                    )
                )
    shown = Shown()
    shown.table(_structure_table(rows))
    shown.table(_answer_table(rows))
    shown.write("evaluate-unposed", figures_title)


def _sent(
    kind: str,
    scan: Scan,
    values: dict[str, Any],
    down: NDArray[np.float64] | None,
    photos_every: int,
    folder: Path,
) -> Sent:
    if kind in (PHOTOS, PHOTOS_DISTANCE, PHOTOS_PLAN):
        scale = _photos_scale(kind, scan, down, photos_every)
        return Sent(name=kind, path=write_photos(scan, photos_every, folder / "photos"), options=scale)
    if kind == VIDEO:
        distance = measured_distance(scan, len(scan.frames) // 2)
        path = write_video(scan, folder / "video.mp4")
        return Sent(name=kind, path=path, options={"scale": distance.option})
    kept = {name: value for name, value in values.items() if name in ("camera", "depth_scale")}
    path = write_depth_frames(scan, folder / "depth")
    return Sent(name=kind, path=path, options={**kept, "format": "tum", "poses": "estimate"}, is_rigid=True)


def _photos_scale(
    kind: str, scan: Scan, down: NDArray[np.float64] | None, photos_every: int
) -> dict[str, Any]:
    if kind == PHOTOS_DISTANCE:
        number = len(scan.frames) // 2 // photos_every * photos_every
        return {"scale": measured_distance(scan, number).in_frame(photo_name(number))}
    if kind == PHOTOS_PLAN:
        if down is None:
            raise InvalidInputError("Places on the plan need to know which way is down: give gravity.")
        return {"scale": plan_places(scan, photos_every, down)}
    return {}


def _structure_table(results: list[UnposedResult]) -> Table:
    columns = (
        "pictures",
        "chosen",
        "connected",
        "camera",
        "focal px",
        "trajectory cm",
        "scale %",
        "up deg",
        "build s",
    )
    table = Table("sent", *columns, title="Poses estimated from the pictures, after one alignment")
    for result in results:
        report = result.report
        table.add_row(result.name, *(str(value) for value in _structure_cells(result, report)))
    return table


def _structure_cells(result: UnposedResult, report: Any) -> Iterator[Any]:
    yield from (report[name] for name in ("pictures", "chosen", "connected"))
    yield report["camera"]["source"]
    yield round(result.camera.focal_px, 1)
    yield round(result.trajectory_cm, 2)
    yield "no scale" if result.scale_error is None else f"{100 * result.scale_error:+.2f}"
    yield "not found" if result.up_error_deg is None else round(result.up_error_deg, 1)
    yield round(result.build_s)


def _answer_table(results: list[UnposedResult]) -> Table:
    columns = (
        "alignment",
        "keyframes",
        "queries",
        "located %",
        "median cm",
        "p90 cm",
        "median deg",
        "wrong %",
    )
    table = Table("sent", *columns, title="Queries in these maps, after the same alignment")
    for result in results:
        summary = result.summary
        cells = (
            "rigid" if result.name == DEPTH else "similarity",
            result.keyframes,
            summary.queries,
            summary.located_percent,
            summary.median_cm or "none",
            summary.p90_cm or "none",
            summary.median_deg or "none",
            summary.gross_percent,
        )
        table.add_row(result.name, *(str(cell) for cell in cells))
    return table
