"""`roomfix evaluate-demo`: phone pictures of the demonstration venue, by region."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from app.commands.console import console, progress_bars, settings_from
from app.commands.demo import DEFAULT_DIR
from app.errors import ConflictError
from app.evaluation.pose_errors import ErrorSummary, QueryOutcome, pose_error, summarize
from app.services.localizer import Localizer
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.vision.images import decode_image

if TYPE_CHECKING:
    from app.demonstration import DemoQuery


def evaluate_demo(
    count: Annotated[int, typer.Option(min=1, help="Pictures of each region.")] = 80,
    data_dir: Annotated[Path, typer.Option(help="The folder of `roomfix demo`.")] = DEFAULT_DIR,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
) -> None:
    """Locate rendered phone pictures of every region in the demonstration venue's map (run `demo --whole` first)."""
    from app.demonstration import REGIONS, VENUE, render_queries

    resources = Resources.open(settings_from(data_dir=data_dir))
    summaries: dict[str, ErrorSummary] = {}
    try:
        serving = MapLibrary(resources).active(VENUE.id)
        if serving is None:
            raise ConflictError("The demonstration venue has no map yet: run roomfix demo --whole first.")
        with progress_bars() as progress:
            for region in REGIONS:
                queries = render_queries(data_dir / f"queries-{region}", count, region=region)
                outcomes = []
                for done, query in enumerate(queries):
                    progress.report(region, done + 1, count)
                    outcomes.append(_locate(serving[0], query))
                summaries[region] = summarize(outcomes)
    finally:
        resources.close()
    console.print(_table(summaries))
    if json_file is not None:
        json_file.write_text(json.dumps({name: s.as_dict() for name, s in summaries.items()}, indent=1))


def _locate(localizer: Localizer, query: DemoQuery) -> QueryOutcome:
    found = localizer.localize(decode_image(query.path.read_bytes()), query.camera)
    position_m, orientation_deg = float("inf"), 180.0
    if found.world_from_camera is not None:
        position_m, orientation_deg = pose_error(found.world_from_camera, query.world_from_camera)
    return QueryOutcome(
        query.name,
        found.world_from_camera is not None,
        position_m,
        orientation_deg,
        found.reason,
        found.evidence.inliers,
        found.confidence,
        sum(found.timings_ms.values()),
    )


def _table(summaries: dict[str, ErrorSummary]) -> Table:
    table = Table("region", "located %", "median cm", "wrong by over 0.5 m %", "not located", "median ms")
    for region, summary in summaries.items():
        table.add_row(
            region,
            str(summary.located_percent),
            str(summary.median_cm),
            str(summary.gross_percent),
            str(summary.reasons),
            str(summary.median_ms),
        )
    return table
