"""`roomfix evaluate-cameras`: queries whose stated camera is wrong."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import parse_build_options
from app.engine.mapping.self_check import check_map
from app.engine.query.localizer import Localizer
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Database, Dataset, JsonFile, Options, Queries
from bench.evaluation.cameras import HEADER, evaluate_cameras
from bench.evaluation.dataset import split_scan
from bench.figures.shown import FiguresTitle, Shown


def evaluate_cameras_command(
    dataset: Dataset,
    database: Database = "0::2",
    queries: Queries = "1::2",
    options: Options = "{}",
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Locate one part of a dataset in a map of the other, with mistakes in the camera that each query states."""
    cap_threads()
    parsed = parse_build_options(json.loads(options))
    split = split_scan(dataset, database, queries, parsed.format, parsed.scan)
    settings = Settings()
    models = open_models(settings)
    with ThreadPoolExecutor(settings.workers) as executor, progress_bars() as progress:
        built = build_map(split.database, parsed, models, executor, progress)
        # As it would be served: with the error that its self-check found stated in it.
        check = check_map(built, split.database, models, executor, progress)
    localizer = Localizer.of(check.stated_in(built.artifact), built.index, models)
    table = Table(*HEADER, title=f"{dataset.name}, {len(split.queries)} pictures")
    figures = evaluate_cameras(localizer, split, built.world_from_scan)
    for row in figures:
        table.add_row(*row.as_row())
    shown = Shown()
    shown.table(table)
    shown.write("evaluate-cameras", figures_title)
    if json_file is not None:
        name = f"{dataset.name}, wrong cameras"
        json_file.write_text(
            json.dumps([row.as_dict(name, parsed.features) for row in figures], allow_nan=False)
        )
