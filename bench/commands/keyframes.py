"""`roomfix keyframes`: keyframe rules compared on a scan (the Visual-Depth Map paper's tables)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.build_map import scan_placement
from app.engine.mapping.keyframe_rule import OPTIONS as RULE_OPTIONS
from app.engine.mapping.keyframe_rule import KeyframeRule, parse_keyframe_rule
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.mapping.select_keyframes import frame_contents
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.errors import InvalidInputError
from app.importers.frames import Scan
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from app.vision.content_keyframes import ALPHA, BETA, FrameContent
from app.vision.features import LocalFeatureExtractor
from bench.commands.evaluate import Database, Dataset, JsonFile, Options
from bench.evaluation.dataset import parse_range
from bench.evaluation.pipelines import PIPELINES, options_for
from bench.evaluation.pose_errors import QueryOutcome
from bench.evaluation.queries import Query, open_queries
from bench.figures.shown import FiguresTitle, Shown
from bench.keyframes.bursts import count_bursts
from bench.keyframes.neighbours import pair_contents, parse_pair
from bench.keyframes.rules import (
    RuleFigures,
    SweepRow,
    frame_similarity,
    measure_rule,
    suggest,
    sweep_content,
)
from bench.reports.cumulative_plot import draw_cumulative
from bench.reports.plot_style import PLOT_SUFFIXES

RULES = ("pose", "content", "distance", "interval", "dense")


Rules = Annotated[
    list[str] | None, typer.Option(help=f"{', '.join(RULES)} (every frame); repeat it to compare.")
]
Alpha = Annotated[float, typer.Option(help="content: limit to the last keyframe.")]
Beta = Annotated[float, typer.Option(help="content: limit to the one before it.")]
Combine = Annotated[str, typer.Option(help="content: and, or.")]
EveryM = Annotated[float, typer.Option(help="distance: metres between keyframes.")]
Every = Annotated[int, typer.Option(help="interval: frames between keyframes.")]
QueriesIn = Annotated[
    str | None, typer.Option(help="Frames to locate, start:stop:step, or a folder with queries.json.")
]
SparseToo = Annotated[bool, typer.Option("--sparse", help="Each rule without pictures too.")]
ByPipelines = Annotated[
    bool, typer.Option("--pipelines", help="Locate by every pipeline, in each rule's map.")
]
Sweep = Annotated[
    bool,
    typer.Option("--sweep", help="Tables over alpha and beta, and what suits; with --queries, how well."),
]
Pairs = Annotated[
    list[str] | None,
    typer.Option(
        "--pair",
        help="Numbers of two frames, first,second: their features, matches and similarity; repeat it.",
    ),
]
Bursts = Annotated[bool, typer.Option("--bursts", help="Keyframes from blurred, repeated stretches.")]


# Table 5 of the Visual-Depth Map paper lists the keyframes among so many frames.
FIRST_FRAMES = 20


def keyframes(
    dataset: Dataset,
    rule: Rules = None,
    alpha: Alpha = ALPHA,
    beta: Beta = BETA,
    combine: Combine = "and",
    every_m: EveryM = RULE_OPTIONS.every_m,
    every: Every = 10,
    database: Database = ":",
    queries: QueriesIn = None,
    sparse: SparseToo = False,
    pipelines: ByPipelines = False,
    sweep: Sweep = False,
    bursts: Bursts = False,
    pair: Pairs = None,
    options: Options = "{}",
    plot: Annotated[Path | None, typer.Option(help="Draw cumulative errors into this file.")] = None,
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Compare keyframe rules on a scan: number, similarity of neighbours, size, accuracy."""
    if (plot is not None or pipelines) and queries is None:
        raise InvalidInputError("--plot and --pipelines need --queries.")
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise InvalidInputError(f"{plot} must end in one of {', '.join(PLOT_SUFFIXES)}.")
    cap_threads()
    content = {"alpha": alpha, "beta": beta, "combine": combine}
    named = _named_rules(rule or ["content"], content, every_m, every)
    base = parse_build_options(_json(options))
    scan = open_scan(dataset, base.format, base.scan)
    part = replace(scan, frames=scan.frames[parse_range(database)])
    asked = open_queries(queries, scan, part.frames) if queries is not None else []
    settings, figures, measured = Settings(), dict[str, Any](), list[RuleFigures]()
    with ThreadPoolExecutor(settings.workers) as executor, progress_bars() as progress:
        bench = _Bench(part, base, asked, open_models(settings), executor, progress)
        if pair:
            figures["pairs"] = bench.pairs([parse_pair(text, len(part.frames)) for text in pair])
        if sweep or bursts:
            figures.update(bench.contents(parse_keyframe_rule({"rule": "content", **content}), sweep, bursts))
        if pipelines:
            measured = bench.pipelines(named)
        elif asked or not (sweep or bursts or pair):
            if sweep:
                named["suggested"] = parse_keyframe_rule(figures["suggested"])
            measured = bench.rules(named, sparse)
    if measured:
        bench.shown.table(_table(measured))
        if not pipelines:
            bench.shown.table(_chosen_table(measured))
        figures["rules"] = [row.as_dict() for row in measured]
    bench.shown.write("keyframes", figures_title)
    if plot is not None:
        draw_cumulative({row.name: row.outcomes for row in measured}, dataset.resolve().name, plot)
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1))


def _named_rules(
    names: Sequence[str], content: dict[str, Any], every_m: float, every: int
) -> dict[str, KeyframeRule]:
    stated: dict[str, dict[str, Any]] = {
        "pose": {"rule": "pose"},
        "content": {"rule": "content", **content},
        "distance": {"rule": "distance", "every_m": every_m},
        "interval": {"rule": "interval", "every": every},
        "dense": {"rule": "interval", "every": 1},
    }
    if unknown := [name for name in names if name not in stated]:
        raise InvalidInputError(f"Rule {unknown[0]!r} is not known; use one of {', '.join(stated)}.")
    return {name: parse_keyframe_rule(stated[name]) for name in names}


class _Bench:
    """A scan, the queries, and what it takes to build maps of the one and locate the others."""

    def __init__(
        self,
        scan: Scan,
        options: BuildOptions,
        queries: Sequence[Query],
        models: VisionModels,
        executor: Executor,
        progress: Progress,
    ) -> None:
        self._scan, self._options, self._queries = scan, options, queries
        self._models, self._executor, self._progress = models, executor, progress
        self.shown = Shown()

    def rules(self, rules: dict[Any, KeyframeRule], sparse: bool) -> list[RuleFigures]:
        rows = []
        for name, rule in rules.items():
            options = replace(self._options, keyframes=rule)
            rows.append(self._measure(name, options))
            if sparse:
                rows.append(self._measure(f"{name}, no pictures", replace(options, store_images=False)))
        return rows

    def pipelines(self, rules: Mapping[Any, KeyframeRule]) -> list[RuleFigures]:
        found = []
        for rule_name, rule in rules.items():
            options = replace(self._options, keyframes=rule)
            for name in PIPELINES:
                label = f"{rule_name}, {name}" if len(rules) > 1 else name
                found.append(
                    measure_rule(
                        label, self._scan, options_for(name, options), self._queries, self._models,
                        self._executor, self._progress, name,
                    )
                )  # fmt: skip
        return found

    def pairs(self, pairs: Sequence[tuple[int, int]]) -> list[dict[str, Any]]:
        extractor = self._models.extractor(self._options.features)
        found = pair_contents(self._scan, pairs, extractor, self._executor, self._progress)
        table = Table("frames", "features of the first", "of the second", "matches", "similarity")
        for each in found:
            counts = each.first_features, each.second_features, each.matches
            table.add_row(f"{each.first}, {each.second}", *map(str, counts), f"{each.similarity:.3f}")
        self.shown.table(table)
        return [asdict(each) for each in found]

    def _measure(self, name: str, options: BuildOptions) -> RuleFigures:
        return measure_rule(
            name, self._scan, options, self._queries, self._models, self._executor, self._progress
        )

    def contents(self, rule: KeyframeRule, sweep: bool, bursts: bool) -> dict[str, Any]:
        extractor = self._models.extractor(self._options.features)
        placed = scan_placement(self._options, self._scan)
        poses = [placed @ frame.scan_from_camera for frame in self._scan.frames]
        frames = list(frame_contents(self._scan, poses, extractor, self._executor, self._progress))
        figures: dict[str, Any] = {}
        if sweep:
            figures.update(_sweep(frames, extractor, rule, self.shown))
        if bursts:
            counted = count_bursts(
                self._scan, frames, rule.content, extractor, self._executor, self._progress
            )
            self.shown.table(_burst_table(counted))
            figures["bursts"] = [{"stretch": a, "keyframes": b, "bare": c} for a, b, c in counted]
        return figures


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError as error:
        raise InvalidInputError(f"options is not JSON: {error}.") from None


def _sweep(
    frames: Sequence[FrameContent], extractor: LocalFeatureExtractor, rule: KeyframeRule, shown: Shown
) -> dict[str, Any]:
    """Print the paper's tables, those of eq. 6 as it stands, and the rule that suits; return both."""
    rows = sweep_content(frames, extractor, replace(rule.content, seen="join"))
    neighbours = frame_similarity(frames, extractor)
    best = suggest(rows, neighbours)
    shown.table(_sweep_table(rows, rule.content.combine))
    shown.line(f"Similarity of the scan's own neighbours: {neighbours:.3f}")
    suggested: dict[str, Any] = {"rule": "pose"}
    if best is not None:
        limits = {"alpha": best.alpha, "beta": best.beta, "combine": rule.content.combine}
        suggested = {"rule": "content", **limits}
    shown.line(f"Suggested for this scene: {json.dumps(suggested)}")
    return {"sweep": [asdict(row) for row in rows], "neighbours": neighbours, "suggested": suggested}


def _sweep_table(rows: Sequence[SweepRow], combine: str) -> Table:
    table = Table(
        "alpha", "beta", "keyframes", "mean", "variance", title=f'Neighbours by eq. 6 with "{combine}"'
    )
    for row in rows:
        table.add_row(
            f"{row.alpha:.2f}",
            f"{row.beta:.2f}",
            str(row.keyframes),
            f"{row.mean:.3f}",
            f"{row.variance:.5f}",
        )
    return table


def _burst_table(rows: Sequence[tuple[str, int, int]]) -> Table:
    table = Table("stretch", "keyframes", "by eq. 6 alone")
    for name, count, bare in rows:
        table.add_row(name, str(count), str(bare))
    return table


def _table(rows: Sequence[RuleFigures]) -> Table:
    table = Table("", *(row.name for row in rows))
    for title, name in (
        ("keyframes", "keyframes"),
        ("features a keyframe", "features_per_keyframe"),
        ("similarity of neighbours, mean", "similarity_mean"),
        ("  variance", "similarity_variance"),
        ("map, MB", "map_mb"),
        ("pictures, MB", "pictures_mb"),
        ("largest keyframe, kB", "kb_per_keyframe"),
        ("build, s", "build_s"),
    ):
        table.add_row(title, *(str(getattr(row, name)) for row in rows))
    if not all(row.summary for row in rows):
        return table
    table.rows[-1].end_section = True
    for title, name in (
        ("queries", "queries"),
        ("located %", "located_percent"),
        ("median cm", "median_cm"),
        ("median deg", "median_deg"),
        ("90 % cm", "p90_cm"),
        ("mean cm", "mean_cm"),
        ("wrong by over 0.5 m %", "gross_percent"),
        ("largest error cm", "max_cm"),
        ("not located", "reasons"),
        ("median ms", "median_ms"),
    ):
        table.add_row(title, *(str(getattr(row.summary, name)) for row in rows))
    for limit_m in (1.0, 2.0):
        table.add_row(f"within {limit_m:g} m %", *(str(_within(row.outcomes, limit_m)) for row in rows))
    table.add_row(
        "confidence, mean", *(f"{np.mean([o.confidence for o in row.outcomes]):.3f}" for row in rows)
    )
    return table


def _chosen_table(rows: Sequence[RuleFigures]) -> Table:
    """Return which of the first frames became keyframes, as the paper's table 5."""
    table = Table("rule", f"keyframes among the first {FIRST_FRAMES} frames", "how many")
    for row in rows:
        first = [number for number in row.frames if number < FIRST_FRAMES]
        table.add_row(row.name, " ".join(str(number) for number in first), str(len(first)))
    return table


def _within(outcomes: Sequence[QueryOutcome], limit_m: float) -> float:
    return round(100.0 * float(np.mean([o.located and o.position_m < limit_m for o in outcomes])), 1)
