"""`roomfix evaluate` and `roomfix benchmark`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.table import Table

from app.commands.console import console, json_object, progress_bars
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.settings import PAPER, LocalizerSettings
from app.errors import InvalidInputError
from app.geometry.estimators.chosen import ESTIMATORS
from app.importers.frames import Scan
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.bursts.frames import MOTION_ERROR_DEG, MOTION_ERROR_RATIO
from bench.bursts.measure import BurstPlan, evaluate_bursts
from bench.evaluation.absent import check_places, locate_absent
from bench.evaluation.benchmark import describe_machine, run_benchmark
from bench.evaluation.dataset import Split, split_scan
from bench.evaluation.keyframe_protocol import split_by_keyframes
from bench.evaluation.naming import name_by_difference
from bench.evaluation.over_http import evaluate_over_http
from bench.evaluation.pipelines import Pipeline, options_for
from bench.evaluation.run import Evaluation, build
from bench.evaluation.run import evaluate as run_evaluation
from bench.evaluation.variations import VARIATIONS, Variation, parse_variations
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.paper_tables import paper_tables
from bench.reports.report import Report
from bench.reports.sections import evaluation_sections
from bench.reports.tables import absent_lines, maps_table, plain_table, variations_table

Dataset = Annotated[Path, typer.Argument(exists=True, file_okay=False, help="A scan in a known format.")]
Datasets = Annotated[
    list[Path], typer.Argument(exists=True, file_okay=False, help="Scans in a known format.")
]
Database = Annotated[
    str, typer.Option(help="Frames of the map: start:stop:step, by order; train for 7-Scenes' own.")
]
Queries = Annotated[str, typer.Option(help="Frames to locate, those of the map left out; or test.")]
Options = Annotated[str, typer.Option(help="JSON, as in POST /database/build.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")]
ReportDir = Annotated[Path | None, typer.Option("--report", help="Write a page with plots into this folder.")]


class PipelineName(StrEnum):
    """The pipelines, as an option that can be repeated needs them."""

    DEFAULT = "default"
    PAPER = "paper"
    TWO_IMAGES = "two-images"
    VDM = "vdm"
    EPIPOLAR = "epipolar"


class Protocol(StrEnum):
    """How frames are divided into database and queries."""

    RANGES = "ranges"
    KEYFRAMES = "keyframes"


DatabaseRange = Annotated[
    str | None, typer.Option(help="Frames of the map: start:stop:step, by order; 0::2 by default.")
]
QueriesRange = Annotated[
    str | None, typer.Option(help="Frames to locate, those of the map left out; 1::2 by default.")
]
ProtocolOption = Annotated[
    Protocol,
    typer.Option(
        help="ranges: --database and --queries; keyframes: the keyframes of the whole scan are the database, all "
        "its other frames are queries (the RGB-D paper's protocol)."
    ),
]
PipelineOption = Annotated[
    list[PipelineName] | None,
    typer.Option(
        help="default; paper: ORB, F-RANSAC, EPnP + LM, one keyframe, 50 matches; two-images: two keyframes, no "
        "depth; vdm, epipolar: lines on the plan; repeat it to compare."
    ),
]
DegradeOption = Annotated[
    list[str] | None,
    typer.Option(
        help=f"Ask the same map with queries made worse: all, {', '.join(VARIATIONS)}; repeat it for several."
    ),
]
AbsentOption = Annotated[
    list[str] | None,
    typer.Option(help="A folder of other places, or synthetic: none may be located; repeat it for several."),
]
BurstOption = Annotated[
    int | None,
    typer.Option(
        min=2, max=8, help="Ask single frames, and bursts of that number of frames with and without motion."
    ),
]
ApartOption = Annotated[float, typer.Option(min=0.01, help="Seconds between the frames of a burst.")]
ServerOption = Annotated[
    str | None,
    typer.Option(help="Evaluate over HTTP, e.g. http://127.0.0.1:8000; with the key in ROOMFIX_ADMIN_KEY."),
]


@dataclass(frozen=True, slots=True)
class _Configuration:
    """One map to build and how to localize in it; `name` tells it apart from the others. `frames` is a split, or the
    scan that is split by its keyframes."""

    name: str
    frames: Split | Scan
    options: BuildOptions
    pipeline: Pipeline
    settings: LocalizerSettings


def evaluate(
    datasets: Datasets,
    database: DatabaseRange = None,
    queries: QueriesRange = None,
    protocol: ProtocolOption = Protocol.RANGES,
    features: Annotated[list[str] | None, typer.Option(help="Feature method; repeat it to compare.")] = None,
    pipeline: PipelineOption = None,
    keyframes: Annotated[int | None, typer.Option(help="Keyframes that a query is matched with.")] = None,
    degrade: DegradeOption = None,
    no_camera: Annotated[
        bool, typer.Option("--no-camera", help="Locate without a camera; the same as --degrade no-camera.")
    ] = False,
    absent: AbsentOption = None,
    server: ServerOption = None,
    burst: BurstOption = None,
    apart_s: ApartOption = 0.2,
    options: Annotated[
        list[str] | None, typer.Option(help="JSON, as in POST /database/build; repeat it to compare.")
    ] = None,
    json_file: JsonFile = None,
    report: ReportDir = None,
    figures: FiguresTitle = None,
) -> None:
    """Build a map from one part of a dataset, locate the other part, compare with the truth."""
    cap_threads()
    variations = parse_variations([*(degrade or []), *(["no-camera"] if no_camera else [])])
    check_places(absent or [])
    parsed = [json_object(each) for each in options or ["{}"]]
    page = None if report is None else Report(_title(datasets), report)
    ranges = _ranges(protocol, database, queries)
    plan = None if burst is None else BurstPlan(burst, apart_s)
    if server is not None:
        if features or pipeline or keyframes is not None or absent or ranges is None or plan is not None:
            raise InvalidInputError(
                "--server takes its pipeline from the server: leave out features, pipeline, keyframes, absent, burst "
                "and --protocol keyframes."
            )
        results = list(_evaluate_there(server, datasets, ranges, parsed, variations))
    else:
        chosen: list[Pipeline] = [name.value for name in pipeline or [PipelineName.DEFAULT]]
        settings = {name: _settings(name, keyframes) for name in chosen}
        configurations = list(_configurations(datasets, ranges, parsed, features, settings))
        results = _evaluate_here(configurations, variations, absent or [], plan)
    shown = _show(results, variations, by_keyframes=ranges is None) if plan is None else _show_bursts(results)
    if server is None:
        shown.line(f"Poses by {ESTIMATORS.name}.")
    shown.write("evaluate" if plan is None else "bursts", figures)
    _write(results, json_file, page)


def _ranges(protocol: Protocol, database: str | None, queries: str | None) -> tuple[str, str] | None:
    """Return the frames of map and queries, None where the keyframes divide the scan."""
    if protocol is Protocol.RANGES:
        return database or "0::2", queries or "1::2"
    if database is not None or queries is not None:
        raise InvalidInputError(
            "--protocol keyframes chooses database and queries itself: leave out --database and --queries."
        )
    return None


def _settings(pipeline: Pipeline, keyframes: int | None) -> LocalizerSettings:
    settings = PAPER if pipeline == "paper" else LocalizerSettings()
    return settings if keyframes is None else replace(settings, keyframes=keyframes)


def _configurations(
    datasets: Sequence[Path],
    ranges: tuple[str, str] | None,
    options: Sequence[dict[str, Any]],
    features: Sequence[str] | None,
    settings: dict[Pipeline, LocalizerSettings],
) -> Iterator[_Configuration]:
    """Yield every dataset with every set of options, pipeline and feature method; without ranges of frames a scan is
    split by its keyframes."""
    for dataset in datasets:
        for difference, given in zip(name_by_difference(options), options, strict=True):
            base = parse_build_options(given)
            frames = (
                open_scan(dataset, base.format, base.scan)
                if ranges is None
                else split_scan(dataset, *ranges, base.format, base.scan)
            )
            for pipeline, localizer_settings in settings.items():
                chosen = options_for(pipeline, base)
                methods = features or [chosen.features]
                name = f"{dataset.resolve().name} {pipeline}" + (f", {difference}" if difference else "")
                for method in methods:
                    checked = parse_build_options({"features": method}).features
                    own = replace(chosen, features=checked)
                    yield _Configuration(name, frames, own, pipeline, localizer_settings)


def _evaluate_here(
    configurations: Sequence[_Configuration],
    variations: Sequence[Variation],
    absent: Sequence[str],
    plan: BurstPlan | None,
) -> list[Evaluation]:
    models = open_models(Settings())
    results: list[Evaluation] = []
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        for configuration in configurations:
            results += _evaluate_map(configuration, variations, absent, plan, models, executor, progress)
    return results


def _evaluate_map(
    configuration: _Configuration,
    variations: Sequence[Variation],
    absent: Sequence[str],
    plan: BurstPlan | None,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> Iterator[Evaluation]:
    """Build once, and ask every variation; absent places once with a camera and once without, as variations are."""
    frames, options, thresholds = configuration.frames, configuration.options, None
    if isinstance(frames, Scan):
        chosen = split_by_keyframes(frames, options, models, executor, progress)
        split, options, thresholds = chosen.split, chosen.options, chosen.thresholds
    else:
        split = frames
    built = build(
        configuration.name,
        split,
        options,
        configuration.settings,
        models,
        executor,
        progress,
        configuration.pipeline,
    )
    if thresholds is not None:
        built = replace(built, figures=replace(built.figures, thresholds=thresholds))
    asked: set[bool] = set()
    for variation in variations:
        if plan is not None:
            yield from evaluate_bursts(built, split, plan, progress, variation)
            continue
        result = run_evaluation(built, split, progress, variation)
        if absent and variation.camera_given not in asked:
            asked.add(variation.camera_given)
            camera = split.database.camera
            found = locate_absent(built.localizer, absent, camera, variation.camera_given, progress)
            result = replace(result, absent=found)
        yield result


def _evaluate_there(
    server: str,
    datasets: Sequence[Path],
    ranges: tuple[str, str],
    options: Sequence[dict[str, Any]],
    variations: Sequence[Variation],
) -> Iterator[Evaluation]:
    key = Settings().admin_key
    headers = {"Authorization": f"Bearer {key.get_secret_value()}"} if key is not None else {}
    with httpx.Client(base_url=server, headers=headers, timeout=300) as client:
        for dataset in datasets:
            for difference, given in zip(name_by_difference(options), options, strict=True):
                base = parse_build_options(given)
                split = split_scan(dataset, *ranges, base.format, base.scan)
                name = dataset.resolve().name + (f", {difference}" if difference else "")
                yield from evaluate_over_http(client, split, name, given, variations)


def _show(results: Sequence[Evaluation], variations: Sequence[Variation], *, by_keyframes: bool) -> Shown:
    shown = Shown()
    if by_keyframes:
        for table in paper_tables([each for each in results if each.variation == variations[0].name]):
            shown.table(plain_table(table))
    shown.table(maps_table([result for result in results if result.variation == variations[0].name]))
    if len(variations) > 1:
        shown.table(variations_table(results))
        for line in absent_lines(results):
            shown.line(line)
    return shown


def _show_bursts(results: Sequence[Evaluation]) -> Shown:
    shown = Shown()
    shown.table(variations_table(results))
    shown.line(
        f"The motion is the true one with a normal error of {MOTION_ERROR_RATIO:.0%} of its length and "
        f"{MOTION_ERROR_DEG:g} degrees; frames of a burst are none of the map's."
    )
    return shown


def _write(results: Sequence[Evaluation], json_file: Path | None, page: Report | None) -> None:
    figures = [result.as_dict() for result in results]
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1, allow_nan=False))
    if page is not None:
        page.add(*evaluation_sections(results, page.directory))
        page.write_json("evaluation.json", figures)
        console.print(f"The report is {page.write()}.", soft_wrap=True)


def _title(datasets: Sequence[Path]) -> str:
    return f"Evaluation of {', '.join(dataset.resolve().name for dataset in datasets)}"


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
    figures_title: FiguresTitle = None,
) -> None:
    """Time a located query on one thread: medians by stage, and the sum of its kernels."""
    cap_threads()
    base = replace(parse_build_options(json_object(options)), features=features)
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
    shown = Shown()
    shown.table(table)
    shown.line(f"Poses by {ESTIMATORS.name}.")
    shown.write("benchmark", figures_title)
    if json_file is not None:
        json_file.write_text(json.dumps({**figures.as_dict(), "machine": describe_machine()}, indent=1))
