"""`roomfix evaluate-demo`: phone pictures of the demonstration venue, by region."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from app.commands.console import console, progress_bars, settings_from
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.errors import ConflictError
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.vision.images import decode_image
from bench.commands.demo import DEFAULT_DIR
from bench.evaluation.map_part import part_of_map
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import summarize
from bench.evaluation.run import Evaluation, map_figures, median_stages
from bench.evaluation.variations import PLAIN, VARIATIONS, Variation, parse_variations
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.report import Report, ReportTable, Section
from bench.reports.sections import cell, evaluation_sections

if TYPE_CHECKING:
    from bench.demo import DemoQuery


def evaluate_demo(
    count: Annotated[int, typer.Option(min=1, help="Pictures of each region.")] = 80,
    data_dir: Annotated[Path, typer.Option(help="The folder of `roomfix demo`.")] = DEFAULT_DIR,
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Ask with pictures made worse: all, {', '.join(VARIATIONS)}; repeat it for several."
        ),
    ] = None,
    without_upper_floor: Annotated[
        bool,
        typer.Option(
            "--without-upper-floor",
            help="Ask for the upper floor's pictures with that floor out of the map too.",
        ),
    ] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write a page with plots into this folder.")
    ] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Locate rendered phone pictures of every region in the demonstration venue's map (run `demo --whole` first)."""
    from bench.demo import REGIONS, VENUE, render_queries

    page = None if report is None else Report(f"Evaluation of {VENUE.name}", report)
    variations = parse_variations(degrade or [])
    resources = Resources.open(settings_from(data_dir=data_dir))
    regions: list[RegionFigures] = []
    try:
        serving = MapLibrary(resources).active(VENUE.id)
        if serving is None:
            raise ConflictError("The demonstration venue has no map yet: run roomfix demo --whole first.")
        with progress_bars() as progress:
            for region in REGIONS:
                queries = render_queries(data_dir / f"queries-{region}", count, region=region)
                regions += [
                    evaluate_region(region, Localizer(serving[0]), queries, progress, variation)
                    for variation in variations
                ]
                if region == "upper" and without_upper_floor:
                    regions += evaluate_absent_floor(
                        Localizer(serving[0]), resources.models, queries, progress, variations
                    )
    finally:
        resources.close()
    shown = Shown()
    shown.table(_table(regions))
    shown.write("evaluate-demo", figures_title)
    figures = [{**each.evaluation.as_dict(), "wrong_floor": each.wrong_floor} for each in regions]
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1, allow_nan=False))
    if page is not None:
        page.add(*evaluation_sections([each.evaluation for each in regions], page.directory))
        page.add(_floor_section(regions))
        page.write_json("evaluation.json", figures)
        console.print(f"The report is {page.write()}.", soft_wrap=True)


@dataclass(frozen=True, slots=True)
class RegionFigures:
    """The figures of a region; `wrong_floor` counts located pictures whose estimate is on another floor."""

    name: str
    evaluation: Evaluation
    wrong_floor: int


def evaluate_absent_floor(
    localizer: Localizer,
    models: VisionModels,
    queries: Sequence[DemoQuery],
    progress: Progress,
    variations: Sequence[Variation],
) -> list[RegionFigures]:
    """Locate pictures of the upper floor in a map of the ground floor's keyframes alone: none may be located."""
    from bench.demo import floor_of

    artifact = localizer.map.artifact
    below = np.array([i for i in range(artifact.keyframe_count) if floor_of(artifact.pose(i)) == 0], np.int64)
    part, index = part_of_map(artifact, localizer.map.index, below, localizer.map.extractor)
    upper = [query for query in queries if query.floor == 1]
    ground = Localizer.of(part, index, models)
    return [evaluate_region("upper, not in the map", ground, upper, progress, each) for each in variations]


def evaluate_region(
    region: str,
    localizer: Localizer,
    queries: Sequence[DemoQuery],
    progress: Progress,
    variation: Variation = PLAIN,
) -> RegionFigures:
    """Locate the pictures of a region, as the variation has them, and compare with the truth, the floor too."""
    from bench.demo import floor_of

    outcomes, timings, wrong_floor = [], [], 0
    for done, query in enumerate(queries):
        progress.report(region, done + 1, len(queries))
        asked = variation.apply(done, query.name, decode_image(query.path.read_bytes()), query.camera)
        camera = asked.camera if variation.camera_given else None
        found = localizer.localize(asked.rgb, camera)
        milliseconds = sum(found.timings_ms.values())
        truth = query.world_from_camera @ asked.original_from_degraded
        outcomes.append(outcome_of(query.name, found, truth, milliseconds))
        if found.world_from_camera is not None:
            timings.append(found.timings_ms)
            wrong_floor += floor_of(found.world_from_camera) != query.floor
    figures = map_figures(region, localizer.map.artifact, int(localizer.map.index.descriptors.nbytes))
    evaluation = Evaluation(
        map=figures,
        variation=variation.name,
        summary=summarize(outcomes),
        stages_ms=median_stages(timings),
        outcomes=tuple(outcomes),
    )
    name = region if variation == PLAIN else f"{region}, {variation.name}"
    return RegionFigures(name, evaluation, wrong_floor)


def _table(regions: Sequence[RegionFigures]) -> Table:
    table = Table()
    table.add_column("region", no_wrap=True)
    for title in (
        "located %",
        "median cm",
        "wrong by over 0.5 m %",
        "wrong floor",
        "not located",
        "median ms",
    ):
        table.add_column(title, min_width=17 if title == "not located" else None)
    for region in regions:
        summary = region.evaluation.summary
        table.add_row(
            region.name,
            str(summary.located_percent),
            str(summary.median_cm),
            str(summary.gross_percent),
            str(region.wrong_floor),
            cell(summary.reasons or None),
            str(summary.median_ms),
        )
    return table


def _floor_section(regions: Sequence[RegionFigures]) -> Section:
    rows = [[each.name, str(len(each.evaluation.outcomes)), str(each.wrong_floor)] for each in regions]
    table = ReportTable(["region", "pictures", "located on another floor"], rows)
    return Section("Wrong floor", "Located pictures whose height is that of another floor.", [table])
