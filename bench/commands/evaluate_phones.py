"""`roomfix evaluate-phones`: queries with EXIF instead of intrinsics, and turned ones with and without gravity."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.options import parse_build_options
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Database, Dataset, JsonFile, Options, Queries
from bench.evaluation.dataset import split_scan
from bench.evaluation.phones import PhoneFigures
from bench.evaluation.phones import evaluate_phones as run_evaluation
from bench.figures.shown import FiguresTitle, Shown


def evaluate_phones(
    dataset: Dataset,
    database: Database = "0::2",
    queries: Queries = "1::2",
    options: Options = "{}",
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Locate one part of a dataset in a map of the other, as phones would ask: with EXIF, or turned."""
    cap_threads()
    base = parse_build_options(json.loads(options))
    split = split_scan(dataset, database, queries, base.format, base.scan)
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        figures = run_evaluation(split, base, open_models(Settings()), executor, progress)
    shown = Shown()
    shown.table(_table(figures))
    shown.write("evaluate-phones", figures_title)
    if json_file is not None:
        json_file.write_text(json.dumps([row.as_dict() for row in figures], indent=1))


def _table(figures: list[PhoneFigures]) -> Table:
    table = Table(
        "queries sent with", "located %", "median cm", "median deg", "90 % cm", "largest cm",
        "focal off % (median, max)", "error / stated", "median ms", "camera from",
    )  # fmt: skip
    for row in figures:
        s = row.summary
        table.add_row(
            row.case, str(s.located_percent), str(s.median_cm), str(s.median_deg), str(s.p90_cm), str(s.max_cm),
            f"{row.focal_median_percent}, {row.focal_max_percent}", str(row.error_over_sigma), str(s.median_ms),
            json.dumps(row.sources),
        )  # fmt: skip
    return table
