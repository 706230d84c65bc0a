"""`roomfix track-anchors`: sessions that one anchor starts, followed by odometry alone."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import direction, progress_bars
from app.engine.anchors.features import AnchorDescriber
from app.engine.mapping.options import parse_build_options
from app.services.resources import cap_threads
from bench.anchors.pairs import PairEvaluator
from bench.anchors.starts import Start, StartSettings, evaluate_starts, growth_rows, summarize_starts
from bench.anchors.thesis import AnchorPipeline, run_thesis_session
from bench.commands.evaluate import Dataset, JsonFile, Options
from bench.evaluation.dataset import split_scan
from bench.figures.shown import FiguresTitle, Shown

GROWTH_HEAD = ("path m", "frames", "median error cm", "90 % cm", "stated sigma cm", "within three sigmas %")


PipelineOption = Annotated[
    AnchorPipeline,
    typer.Option(help="default: what the service does; thesis: the monitoring-camera thesis's equations."),
]


def track_anchors(
    dataset: Dataset,
    monitors: Annotated[str, typer.Option(help="Frames of which one plays the monitoring camera.")] = "0:300",
    frames: Annotated[str, typer.Option(help="Frames of the video.")] = "300:",
    gravity: Annotated[str, typer.Option(help="Down in the scan's frame, x,y,z.")] = "0,0,-1",
    starts: Annotated[int, typer.Option(min=1, help="Sessions, spread over the video.")] = 20,
    length: Annotated[int, typer.Option(min=2, help="Frames of each session.")] = 100,
    anchored: Annotated[
        int, typer.Option(min=1, help="Frames of each on which the anchor can be asked.")
    ] = 30,
    pois: Annotated[int, typer.Option(min=1, help="POIs of each anchor.")] = 1,
    anywhere: Annotated[
        bool, typer.Option("--anywhere", help="POIs anywhere, not only on things that catch the eye.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Which monitoring frames and POIs are drawn.")] = 1,
    pipeline: PipelineOption = AnchorPipeline.DEFAULT,
    options: Options = "{}",
    json_file: JsonFile = None,
    figures: FiguresTitle = None,
) -> None:
    """Start sessions by one monitoring camera's frame and its POIs, with no map, and follow the video by odometry."""
    cap_threads()
    parsed = parse_build_options(json.loads(options))
    split = split_scan(dataset, monitors, frames, parsed.format, parsed.scan)
    settings = StartSettings(
        starts=starts, frames=length, anchored=anchored, pois=pois, seed=seed, anywhere=anywhere
    )
    with progress_bars() as progress:
        outcomes = evaluate_starts(
            split.database,
            split.database.frames,
            split.queries,
            direction(gravity),
            settings,
            PairEvaluator(AnchorDescriber()),
            progress,
            run_thesis_session if pipeline is AnchorPipeline.THESIS else None,
        )
    found = [each for each in outcomes if isinstance(each, Start)]
    summary = summarize_starts(outcomes)
    table = Table(
        show_header=False, title=f"{dataset.resolve().name}, {pois} POIs an anchor, {pipeline.value}"
    )
    for name, value in summary.items():
        table.add_row(name, str(value))
    shown = Shown()
    shown.table(table)
    growth = Table(*GROWTH_HEAD, title="Error on the plan since the anchor was there")
    for row in growth_rows(found):
        growth.add_row(*row)
    shown.table(growth)
    shown.write("track-anchors", figures)
    if json_file is not None:
        json_file.write_text(
            json.dumps({**summary, "sessions": [asdict(start) for start in found]}, indent=1)
        )
