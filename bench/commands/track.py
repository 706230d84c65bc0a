"""`roomfix track`: a dataset's frames as a video."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from app.importers.frames import Frame
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Database, Dataset, JsonFile, Options
from bench.evaluation.dataset import split_scan
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.plot_style import PLOT_SUFFIXES
from bench.tracking.plot import draw_tracking
from bench.tracking.sequences import TrackedFrame, TrackingFigures, VideoSettings, track_video
from bench.tracking.trajectories import HEAD, compare_tracked, compare_trajectory, read_trajectory

Trajectories = Annotated[
    list[Path] | None,
    typer.Option(
        exists=True,
        dir_okay=False,
        help="A trajectory that another program made of the same frames, in TUM's format (ORB-SLAM3, RTAB-Map): its "
        "errors beside ours; repeat it for several.",
    ),
]
TITLES = {
    "tracked_percent": "tracked %",
    "median_cm": "median cm",
    "p90_cm": "90 % cm",
    "mean_cm": "mean cm",
    "max_cm": "largest error cm",
    "median_deg": "median deg",
    "within_3_sigma_percent": "within three sigmas %",
    "wrong_by_half_a_metre": "wrong by over 0.5 m",
    "path_m": "path m",
    "drift_percent": "drift, % of the path",
    "largest_error_percent": "largest error, % of the path",
    "scale_distance_m": "known distance m",
    "scale": "tracked / known distance",
    "mean_ms": "mean ms a frame",
    "median_ms": "median ms a frame",
    "locate_mean_ms": "mean ms of /locate",
    "locate_median_ms": "median ms of /locate",
    "time_share": "time of tracking / of locating",
    "states": "states",
    "reasons": "not located",
}


def track(
    dataset: Dataset,
    database: Database = "0:300",
    frames: Annotated[str, typer.Option(help="Frames of the video, those of the map left out.")] = "300:",
    no_map_after: Annotated[
        int | None, typer.Option(min=1, help="Frames after which the map is taken away; odometry goes on.")
    ] = None,
    relocalize_every: Annotated[
        int | None,
        typer.Option(min=1, help="With --no-map-after: frames from one use of the map to the next."),
    ] = None,
    and_back: Annotated[
        int,
        typer.Option(
            min=0, help="So often the phone goes there by every second frame, and back by those between."
        ),
    ] = 0,
    own_views: Annotated[bool, typer.Option(help="Recognise what the session has seen itself.")] = True,
    trajectory: Trajectories = None,
    options: Options = "{}",
    plot: Annotated[Path | None, typer.Option(help="Draw path and error into this file.")] = None,
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Build a map from one part of a dataset and track the other part as a video."""
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise InvalidInputError(f"{plot} must end in one of {', '.join(PLOT_SUFFIXES)}.")
    cap_threads()
    parsed = parse_build_options(json.loads(options))
    split = split_scan(dataset, database, frames, parsed.format, parsed.scan)
    video = VideoSettings(no_map_after, relocalize_every, and_back=and_back, own_views=own_views)
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        figures, tracked = track_video(split, parsed, video, open_models(Settings()), executor, progress)
    title = f"{dataset.resolve().name}, {figures.frames} frames, {describe(video)}"
    shown = Shown()
    shown.table(_table(figures, title))
    if trajectory:
        shown.table(_trajectories(trajectory, split.queries, tracked))
    shown.write("track", figures_title)
    if plot is not None:
        draw_tracking(tracked, title, plot)
    if json_file is not None:
        json_file.write_text(json.dumps(_as_json(figures, tracked), indent=1))


def describe(video: VideoSettings) -> str:
    """Return in words which way the phone went, and when the map was used."""
    often = "" if video.and_back == 1 else f" {video.and_back} times"
    way = f", there and back{often}" if video.and_back else ""
    way += "" if video.own_views else ", own views not recognised"
    if video.map_frames is None:
        return f"with the map{way}"
    again = f", then every {video.relocalize_every}th" if video.relocalize_every else ""
    first = f"map on the first {video.map_frames} frames" if video.map_frames > 1 else "one fix"
    return f"{first}{again}{way}"


def _trajectories(paths: Sequence[Path], frames: Sequence[Frame], tracked: Sequence[TrackedFrame]) -> Table:
    table = Table(*HEAD, title="Places, aligned with the true path")
    others = [row for path in paths for row in compare_trajectory(path.name, read_trajectory(path), frames)]
    for row in [*compare_tracked("Roomfix", tracked), *others]:
        table.add_row(*row.cells())
    return table


def _table(figures: TrackingFigures, title: str) -> Table:
    table = Table(show_header=False, title=title)
    for name, shown in TITLES.items():
        table.add_row(shown, str(getattr(figures, name)))
    return table


def _as_json(figures: TrackingFigures, frames: list[TrackedFrame]) -> dict[str, object]:
    rows = [{name: getattr(frame, name) for name in TrackedFrame.__slots__} for frame in frames]
    for row in rows:
        row["error_m"] = None if row["position"] is None else row["error_m"]
    return {**figures.as_dict(), "per_frame": rows}
