"""`roomfix evaluate` and `roomfix benchmark`."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.commands.console import console, progress_bars
from app.evaluation.benchmark import describe_machine, run_benchmark
from app.evaluation.dataset import Split, split_scan
from app.evaluation.over_http import evaluate_over_http
from app.evaluation.pipelines import Pipeline, options_for
from app.evaluation.run import Evaluation, count_false_fixes, list_images
from app.evaluation.run import evaluate as run_evaluation
from app.services.build_options import BuildOptions, parse_build_options
from app.services.localizer import PAPER, LocalizerSettings
from app.services.resources import cap_threads, open_models
from app.settings import Settings

Dataset = Annotated[Path, typer.Argument(exists=True, file_okay=False, help="A scan in a known format.")]
Database = Annotated[str, typer.Option(help="Frames of the map: start:stop:step, by order.")]
Queries = Annotated[str, typer.Option(help="Frames to locate, those of the map left out.")]
Options = Annotated[str, typer.Option(help="JSON, as in POST /database/build.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")]


def evaluate(
    dataset: Dataset,
    database: Database = "0::2",
    queries: Queries = "1::2",
    features: Annotated[list[str] | None, typer.Option(help="Feature method; repeat it to compare.")] = None,
    pipeline: Annotated[
        Pipeline,
        typer.Option(help="paper: ORB, F-RANSAC, EPnP + LM, one keyframe; vdm, epipolar: lines on the plan."),
    ] = "default",
    keyframes: Annotated[int | None, typer.Option(help="Keyframes that a query is matched with.")] = None,
    absent: Annotated[
        Path | None, typer.Option(exists=True, help="Images of other places: none may be located.")
    ] = None,
    server: Annotated[
        str | None,
        typer.Option(
            help="Evaluate over HTTP, e.g. http://127.0.0.1:8000; with the key in ROOMFIX_ADMIN_KEY."
        ),
    ] = None,
    options: Options = "{}",
    json_file: JsonFile = None,
) -> None:
    """Build a map from one part of a dataset, locate the other part, compare with the truth."""
    cap_threads()
    base = parse_build_options(json.loads(options))
    split = split_scan(dataset, database, queries, base.format, base.scan)
    if server is not None:
        key = Settings().admin_key
        plain = key.get_secret_value() if key is not None else None
        results = [evaluate_over_http(server, split, dataset, json.loads(options), plain)]
    else:
        results = _evaluate_here(dataset.name, split, base, features, pipeline, keyframes, absent)
    console.print(_table(results))
    if json_file is not None:
        json_file.write_text(json.dumps(results, indent=1, default=str))


def _evaluate_here(
    name: str,
    split: Split,
    base: BuildOptions,
    features: list[str] | None,
    pipeline: Pipeline,
    keyframes: int | None,
    absent: Path | None,
) -> list[dict[str, Any]]:
    settings = PAPER if pipeline == "paper" else LocalizerSettings()
    if keyframes is not None:
        settings = replace(settings, keyframes=keyframes)
    base = options_for(pipeline, base)
    methods = features or [base.features]
    models, results = open_models(Settings()), []
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        for method in methods:
            options = replace(base, features=parse_build_options({"features": method}).features)
            figures, localizer = run_evaluation(
                f"{name} {pipeline}", split, options, settings, models, executor, progress, pipeline
            )
            result = _flat(figures)
            if absent is not None:
                images = list_images(absent)
                false, highest = count_false_fixes(localizer, images, split.database.camera)
                result["absent"] = {"images": len(images), "located": len(false), "most_inliers": highest}
            results.append(result)
    return results


def benchmark(
    dataset: Dataset,
    database: Database = "0::2",
    queries: Queries = "1::2",
    features: Annotated[str, typer.Option(help="Feature method.")] = "sift",
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each query; its median counts.")] = 3,
    compare: Annotated[
        bool, typer.Option("--compare", help="Time a plain SIFT pipeline in the same run.")
    ] = False,
    options: Options = "{}",
    json_file: JsonFile = None,
) -> None:
    """Time a located query on one thread: medians by stage, and the sum of its kernels."""
    cap_threads()
    base = replace(parse_build_options(json.loads(options)), features=features)
    split = split_scan(dataset, database, queries, base.format, base.scan)
    with ThreadPoolExecutor(1) as executor, progress_bars() as progress:
        figures = run_benchmark(split, base, open_models(Settings()), executor, progress, repeats, compare)
    table = Table(
        "what", "ms (median, one thread)", title=f"{figures.located} of {figures.queries} queries located"
    )
    table.add_row("decode", f"{figures.decode_ms:.2f}")
    for stage, milliseconds in figures.stages_ms.items():
        table.add_row(stage, f"{milliseconds:.2f}")
    table.add_row("query without decode", f"{figures.total_ms:.2f}", end_section=True)
    for name, milliseconds in figures.kernels_ms.items():
        table.add_row(f"kernel: {name}", f"{milliseconds:.2f}")
    table.add_row("sum of kernels", f"{figures.kernels_sum_ms:.2f}", end_section=True)
    if figures.plain_sift_ms is not None:
        table.add_row(
            f"plain SIFT pipeline ({figures.plain_sift_located} located)", f"{figures.plain_sift_ms:.2f}"
        )
        table.add_row("query / plain SIFT", f"{figures.ratio}")
    console.print(table)
    if json_file is not None:
        json_file.write_text(json.dumps({**figures.as_dict(), "machine": describe_machine()}, indent=1))


def _flat(figures: Evaluation) -> dict[str, Any]:
    return figures.as_dict()


ROWS = {
    "queries": "queries",
    "located %": "located_percent",
    "median cm": "median_cm",
    "median deg": "median_deg",
    "90 % cm": "p90_cm",
    "90 % deg": "p90_deg",
    "mean cm": "mean_cm",
    "mean deg": "mean_deg",
    "within 5 cm, 5 deg %": "within_5cm_5deg_percent",
    "within 10 cm, 5 deg %": "within_10cm_5deg_percent",
    "wrong by over 0.5 m %": "gross_percent",
    "largest error cm": "max_cm",
    "not located": "reasons",
    "median ms": "median_ms",
}


def _table(results: list[dict[str, Any]]) -> Table:
    table = Table("", *(f"{result['name']}, {result['features']}" for result in results))
    for name in ("keyframes", "features_per_keyframe", "megabytes", "build_s", "discarded"):
        table.add_row(name.replace("_", " "), *(str(result.get(name)) for result in results))
    for title, name in ROWS.items():
        table.add_row(title, *(str(result["summary"][name]) for result in results))
    if any("absent" in result for result in results):
        table.add_row(
            "absent places located",
            *(
                f"{r['absent']['located']} of {r['absent']['images']}" if "absent" in r else ""
                for r in results
            ),
        )
        table.add_row(
            "  most inliers there", *(str(r.get("absent", {}).get("most_inliers")) for r in results)
        )
    return table
