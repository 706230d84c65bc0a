"""`roomfix evaluate-anchors`: monitoring cameras and phones in a recorded scan or the demonstration venue."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.commands.console import console, direction, progress_bars, settings_from
from app.engine.anchors.features import AnchorDescriber
from app.engine.mapping.options import parse_build_options
from app.errors import ConflictError, InvalidInputError
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.services.map_library import MapLibrary
from app.services.resources import Resources, cap_threads
from app.storage.floors import list_floors
from app.vision.images import Rgb
from bench.anchors.features import compared_methods, match_quality
from bench.anchors.maps import evaluate_in_map, summarize_corners
from bench.anchors.match_pictures import draw_matches
from bench.anchors.pairs import (
    CONDITIONS,
    SUMMARY_HEAD,
    AnchorOutcome,
    AnchorPair,
    AnchorSummary,
    PairEvaluator,
    summarize_outcomes,
    tilted,
)
from bench.anchors.plot import draw_errors, draw_summaries
from bench.anchors.queries import choose_first, time_queries
from bench.anchors.report import anchor_section, query_section, write_report
from bench.anchors.sequences import posed_pictures, sample_pairs
from bench.anchors.thesis import AnchorPipeline, ThesisEvaluator
from bench.figures.shown import FiguresTitle, Shown

ANGLES_DEG = (0, 15, 30, 45, 60, 75)
DISTANCES_M = (0.0, 2.5, 5.0, 7.5, 10.0, 12.5)
HARD_CONDITIONS_PAIRS = 60
ROLL_DEG = 30.0
MATCH_PAIRS = 40
PLOTS = {
    "anchors.png": "Located share (bars) and mean error (dots)",
    "anchor-errors.png": "Share of all pairs by error",
}
ANGLE_RANGE = (3.0, 45.0)
DISTANCE_RANGE = (2.0, 10.0)


Hard = Annotated[
    int, typer.Option(min=0, help="Pairs of roll, light, blur, resolution and people; 0 leaves them out.")
]
Conditions = Annotated[
    bool, typer.Option(help="Of those pairs light, blur, resolution and people too, not roll alone.")
]
Pipelines = Annotated[
    list[AnchorPipeline] | None,
    typer.Option(
        help="default: what the service does; thesis: the monitoring-camera thesis's equations; repeat it to compare."
    ),
]
CompareFeatures = Annotated[
    bool, typer.Option(help="Of a scan, count each feature method's right matches too.")
]
MapDir = Annotated[
    Path | None,
    typer.Option(help="Calibrate in the demonstration venue's map of this folder (`demo --whole`)."),
]


def evaluate_anchors(
    scan: Annotated[
        Path | None, typer.Argument(exists=True, file_okay=False, help="A scan with depth.")
    ] = None,
    gravity: Annotated[str, typer.Option(help="Down in the scan's frame, x,y,z.")] = "0,0,-1",
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    demo: Annotated[
        Path | None, typer.Option(help="Folder for rendered pairs of the demonstration venue.")
    ] = None,
    count: Annotated[int, typer.Option(min=20, help="Pairs.")] = 200,
    seed: Annotated[int, typer.Option(help="Which pairs are drawn.")] = 11,
    workers: Annotated[int, typer.Option(min=1, help="Processes that render.")] = 1,
    pipeline: Pipelines = None,
    hard: Hard = HARD_CONDITIONS_PAIRS,
    conditions: Conditions = True,
    compare_features: CompareFeatures = True,
    data_dir: MapDir = None,
    out: Annotated[
        Path | None, typer.Option(help="Write tables (JSON) and plots (PNG) to this folder.")
    ] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Locate phones by monitoring cameras, against angle, distance, light, blur, resolution and people in the way."""
    cap_threads()
    describer = AnchorDescriber()
    evaluator = PairEvaluator(describer)
    if (scan is None) == (demo is None):
        raise InvalidInputError(
            "Name either a scan or, with --demo, a folder for the demonstration venue's pairs."
        )
    figures: dict[str, Any] = {}
    shown = Shown()
    if scan is not None:
        opened = open_scan(scan, None, _scan_options(options))
        pairs = sample_pairs(opened, direction(gravity), count, seed)
        if compare_features:
            figures["matches"] = _matches(opened, seed, shown, out)
        title, turned = scan.name, [tilted(pair, ROLL_DEG) for pair in pairs[:hard]]
    else:
        assert demo is not None  # noqa: S101 - checked above
        pairs, turned = _demo_pairs(demo, count, seed, workers, hard)
        title = "demonstration venue"
        if data_dir is not None:
            figures["map"] = _in_map(evaluator, demo, count, seed, data_dir, shown)
        figures["retrieval"] = _retrieval(evaluator, pairs, shown)
        figures["timings"] = _timings(describer, demo, seed, workers, shown)
    besides = dict(figures)
    tables = _by_pipelines(evaluator, pipeline, pairs, turned, title, out, CONDITIONS if conditions else {})
    for name, rows in tables.items():
        shown.table(_table(name, rows))
    shown.write("evaluate-anchors", figures_title)
    figures |= {
        name: {row: asdict(summary) for row, summary in rows.items()} for name, rows in tables.items()
    }
    if out is not None:
        (out / "anchors.json").write_text(json.dumps(figures, indent=1))
        sections = [anchor_section(title, tables, out, PLOTS), query_section(besides)]
        console.print(f"Wrote {write_report(sections, out)}.")


def _by_pipelines(
    evaluator: PairEvaluator,
    pipelines: Sequence[AnchorPipeline] | None,
    pairs: list[AnchorPair],
    turned: list[AnchorPair],
    title: str,
    out: Path | None,
    changes: Mapping[str, Callable[[Rgb], Rgb] | None],
) -> dict[str, dict[str, AnchorSummary]]:
    """Return the tables of each pipeline; plots are drawn of the first one."""
    chosen = list(pipelines or [AnchorPipeline.DEFAULT])
    tables: dict[str, dict[str, AnchorSummary]] = {}
    for name in chosen:
        own = ThesisEvaluator(evaluator.describer) if name is AnchorPipeline.THESIS else evaluator
        found = _located(own, pairs, turned, title, out if name is chosen[0] else None, changes)
        for table, rows in found.items():
            tables[f"{name.value}: {table}" if len(chosen) > 1 else table] = rows
    return tables


def _located(
    evaluator: PairEvaluator,
    pairs: list[AnchorPair],
    turned: list[AnchorPair],
    title: str,
    out: Path | None,
    changes: Mapping[str, Callable[[Rgb], Rgb] | None],
) -> dict[str, dict[str, AnchorSummary]]:
    plain, upright = _all(evaluator, pairs, "gravity"), _all(evaluator, pairs, "upright", with_gravity=False)
    ways = {"gravity": plain, "upright assumed": upright}
    few, conditions = pairs[: len(turned)], {}
    if few:
        ways["gravity, first pairs"] = plain[: len(few)]
        ways["upright assumed, first pairs"] = ways["upright assumed"][: len(few)]
        ways["30 deg roll, gravity"] = _all(evaluator, turned, "tilted")
        ways["30 deg roll, upright assumed"] = _all(evaluator, turned, "tilted, assumed", with_gravity=False)
        conditions = {
            name: [evaluator.evaluate(pair, change) for pair in few] for name, change in changes.items()
        }
    tables = {
        "vertical": _summaries(ways),
        "angle at the POI (deg)": _summaries(_binned(plain, ANGLES_DEG, "angle_deg")),
        "distance of the POI (m)": _summaries(_binned(plain, DISTANCES_M, "distance_m")),
    }
    if conditions:
        tables["condition"] = _summaries(conditions)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        draw_summaries(
            {name: tables[name] for name in list(tables)[1:]}, f"Anchors: {title}", out / "anchors.png"
        )
        draw_errors(ways, f"Anchors: {title}", out / "anchor-errors.png")
    return tables


def _all(
    evaluator: PairEvaluator, pairs: Sequence[AnchorPair], stage: str, *, with_gravity: bool = True
) -> list[AnchorOutcome]:
    outcomes = []
    with progress_bars() as progress:
        for done, pair in enumerate(pairs):
            outcomes.append(evaluator.evaluate(pair, with_gravity=with_gravity))
            progress.report(stage, done + 1, len(pairs))
    return outcomes


def _binned(
    outcomes: Sequence[AnchorOutcome], edges: Sequence[float], what: str
) -> dict[str, list[AnchorOutcome]]:
    bins = {
        f"{low:g}-{high:g}": [o for o in outcomes if low <= getattr(o.pair, what) < high]
        for low, high in pairwise(edges)
    }
    return {name: group for name, group in bins.items() if group}


def _summaries(groups: Mapping[str, Sequence[AnchorOutcome]]) -> dict[str, AnchorSummary]:
    return {name: summarize_outcomes(group) for name, group in groups.items()}


def _table(name: str, rows: Mapping[str, AnchorSummary]) -> Table:
    table = Table(name, *SUMMARY_HEAD)
    for row, summary in rows.items():
        table.add_row(row, *summary.cells())
    return table


def _demo_pairs(
    folder: Path, count: int, seed: int, workers: int, hard: int
) -> tuple[list[AnchorPair], list[AnchorPair]]:
    """Return rendered pairs, and the first ones with their phones rolled."""
    from bench.anchors.demo_anchors import anchor_pair
    from bench.recordings.monitors import render_monitor_pairs, render_rolled_phones

    directory = _pairs_dir(folder, count, seed)
    with progress_bars() as progress:
        rendered = render_monitor_pairs(
            directory, count, ANGLE_RANGE, DISTANCE_RANGE, seed=seed, workers=workers,
            progress=lambda done, total: progress.report("render", done, total),
        )  # fmt: skip
        rolled = render_rolled_phones(
            directory.with_name(f"{directory.name}-rolled-{hard}"), rendered[:hard], ROLL_DEG, seed=seed,
            workers=workers, progress=lambda done, total: progress.report("roll", done, total),
        ) if hard else []  # fmt: skip
    return [anchor_pair(pair) for pair in rendered], [anchor_pair(pair) for pair in rolled]


def _in_map(
    evaluator: PairEvaluator, folder: Path, count: int, seed: int, data_dir: Path, shown: Shown
) -> dict[str, Any]:
    """Print and return how well cameras find themselves in the venue's map, and phones in corners taken out of it."""
    from bench.anchors.demo_anchors import map_pair
    from bench.demo import VENUE
    from bench.recordings.monitors import render_monitor_pairs

    rendered = render_monitor_pairs(
        _pairs_dir(folder, count, seed), count, ANGLE_RANGE, DISTANCE_RANGE, seed=seed
    )
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        serving = MapLibrary(resources).active(VENUE.id)
        if serving is None:
            raise ConflictError("The demonstration venue has no map yet: run roomfix demo --whole first.")
        with resources.database.read() as connection:
            floors = {floor.id: floor for floor in list_floors(connection, VENUE.id)}
        outcomes = evaluate_in_map(evaluator, serving[0], floors, [map_pair(pair) for pair in rendered])
    finally:
        resources.close()
    figures = summarize_corners(outcomes)
    table = Table("in the map", "value")
    for name, value in figures.items():
        table.add_row(name, str(value))
    shown.table(table)
    return figures


def _pairs_dir(folder: Path, count: int, seed: int) -> Path:
    return folder / f"pairs-{seed}-{count}"


def _retrieval(evaluator: PairEvaluator, pairs: Sequence[AnchorPair], shown: Shown) -> dict[str, int]:
    found = choose_first(evaluator, pairs)
    shown.line(
        f"A right one of 20 anchors is first by visual words for {found.by_words} of {found.asked} phones, by matches "
        f"for {found.by_matches}."
    )
    return asdict(found)


def _timings(
    describer: AnchorDescriber, folder: Path, seed: int, workers: int, shown: Shown
) -> dict[str, Any]:
    from bench.anchors.demo_anchors import HD_PHONE, anchor_pair
    from bench.recordings.monitors import render_monitor_pairs

    rendered = render_monitor_pairs(
        folder / f"pairs-hd-{seed}",
        20,
        ANGLE_RANGE,
        DISTANCE_RANGE,
        seed=seed,
        workers=workers,
        phone_camera=HD_PHONE,
    )
    with tempfile.TemporaryDirectory() as scratch:
        resources = Resources.open(settings_from(data_dir=Path(scratch)))
        try:
            times = time_queries(resources, describer, [anchor_pair(pair, HD_PHONE) for pair in rendered])
        finally:
            resources.close()
    table = Table(
        "stage", "median ms", title=f"1280 x 720, 20 anchors, {times.located} of {times.queries} located"
    )
    for stage, value in times.stages_ms.items():
        table.add_row(stage, f"{value:g}")
    table.add_row("total", f"{times.total_ms:g}")
    shown.table(table)
    shown.line(f"A-KAZE extraction is {100 * times.akaze_share:.0f} % of a query.")
    return asdict(times)


def _matches(scan: Scan, seed: int, shown: Shown, out: Path | None) -> dict[str, dict[str, Any]]:
    """Print and return the right matches of each feature method by the angle between the optical axes; with `out` the
    first pair of each range is drawn."""
    table = Table("axes apart (deg)", "features", "right %", "right matches", "extract ms")
    found: dict[str, dict[str, Any]] = {}
    for low, high in pairwise(ANGLES_DEG):
        pictures = posed_pictures(scan, low, high, MATCH_PAIRS, seed)
        if len(pictures) < MATCH_PAIRS // 2:
            continue
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            draw_matches(compared_methods(), pictures[0], out / f"matches-{low}-{high}.png")
        for method in compared_methods():
            quality = match_quality(method, pictures)
            found.setdefault(f"{low}-{high}", {})[quality.features] = asdict(quality)
            cells = f"{quality.right_percent:g}", f"{quality.right:g}", f"{quality.extract_ms:g}"
            table.add_row(f"{low}-{high}", quality.features, *cells)
    shown.table(table)
    return found


def _scan_options(options: str) -> ScanOptions:
    try:
        return parse_build_options(json.loads(options)).scan
    except ValueError:
        raise InvalidInputError("--options is not JSON.") from None
