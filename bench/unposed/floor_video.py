"""`roomfix evaluate-video`: a map of a plain video of four minutes through a rendered storey, and what it takes."""

from __future__ import annotations

import resource
import time
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.self_check import check_map
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.importers.frames import DepthFormat, Frame, Scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.evaluation.pose_errors import ErrorSummary
from bench.figures.shown import FiguresTitle, Shown
from bench.formats.evaluate import FormatQueries, locate_queries
from bench.unposed.evaluate import Sent, UnposedResult, evaluate_unposed
from bench.unposed.inputs import write_video

if TYPE_CHECKING:
    from bench.recordings.floor_video import FloorVideo

DEFAULT_DIR = Path(".roomfix/floor-video")
KB_PER_GB = 1e6
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(slots=True, kw_only=True)
class WatchedProgress:
    """Passes reports on, and notes each stage's time, and the longest time without a report and its stage.

    `stage_s` is the time of a stage on the clock and of the processor, seconds.
    """

    inner: Progress
    stage: str = "start"
    longest_s: float = 0.0
    longest_in: str = "start"
    stage_s: dict[str, tuple[float, float]] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)
    _last_cpu: float = field(default_factory=time.process_time)

    def report(self, stage: str, done: int, total: int) -> None:
        """Note a report."""
        now, cpu = time.perf_counter(), time.process_time()
        clock_s, processor_s = self.stage_s.get(self.stage, (0.0, 0.0))
        self.stage_s[self.stage] = clock_s + now - self._last, processor_s + cpu - self._last_cpu
        if now - self._last > self.longest_s:
            self.longest_s, self.longest_in = now - self._last, self.stage
        self._last, self._last_cpu, self.stage = now, cpu, stage
        self.inner.report(stage, done, total)


def evaluate_video(
    folder: Annotated[Path, typer.Option(help="Where the rendered videos are, or are made.")] = DEFAULT_DIR,
    floor: Annotated[str, typer.Option(help="Which storey: upper, or ground.")] = "upper",
    seconds: Annotated[float, typer.Option(min=10, help="Length of the video that is sent.")] = 240.0,
    building: Annotated[
        int, typer.Option(min=0, help="Building that is filmed, by another hand; 0 is the demonstration.")
    ] = 0,
    scanned: Annotated[
        bool, typer.Option("--scanned", help="Map the same walk with depth and true poses, to compare with.")
    ] = False,
    figures_title: FiguresTitle = None,
) -> None:
    """Build a map of a plain video of a rendered storey, a marker at its start, and locate phone pictures in it."""
    from bench.recordings.floor_video import FLOORS, FPS, render_floor_video

    if floor not in FLOORS:
        raise typer.BadParameter(f"{floor!r} is none of {', '.join(FLOORS)}.", param_hint="--floor")
    cap_threads()
    filmed = FLOORS[floor].of_building(building)
    folder = folder / filmed.name.replace(" ", "-")
    shown = Shown()
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        video = render_floor_video(
            folder,
            filmed,
            frames=round(seconds * FPS),
            workers=1,
            progress=lambda done, total: progress.report("render", done, total),
            with_depth=scanned,
        )
        truth, queries = scan_of(video), queries_of(video)
        if scanned:
            shown.table(_scanned_table(truth, queries, executor, progress))
        else:
            _show_video(shown, truth, queries, executor, progress, folder)
    shown.write("evaluate-video", figures_title)


def _show_video(
    shown: Shown, truth: Scan, queries: FormatQueries, executor: Executor, progress: Progress, folder: Path
) -> None:
    """Build a map of the frames as a plain video, and show what came of it."""
    from bench.recordings.floor_video import FPS, MARKER_SIDE_M

    path, length_s = folder / "video.mp4", len(truth.frames) / FPS
    if not path.is_file():
        write_video(truth, path, FPS)
    options = {"format": "video", "scale": {"marker_m": MARKER_SIDE_M}}
    sent = Sent(name="video, marker at the start", path=path, options=options, is_rigid=True)
    watched, models = WatchedProgress(inner=progress), open_models(Settings())
    try:
        with TemporaryDirectory(prefix="roomfix-video-", dir=folder) as scratch:
            result = evaluate_unposed(sent, truth, DOWN, queries, models, executor, watched, Path(scratch))
    except InvalidScanError as error:
        shown.line(f"The video of {length_s:.0f} s is refused: {error}")
    else:
        shown.line("It is built.")
        shown.table(_map_table(result, watched, length_s))
        shown.table(_answer_table(result.keyframes, result.summary))
    shown.table(_stage_table(watched))


def _scanned_table(truth: Scan, queries: FormatQueries, executor: Executor, progress: Progress) -> Table:
    """Locate the pictures in a map of the frames with their depth and true poses."""
    models = open_models(Settings())
    built = build_map(truth, BuildOptions(), models, executor, progress)
    check = check_map(built, truth, models, executor, progress)
    localizer = Localizer.of(check.stated_in(built.artifact), built.index, models)
    scan_from_world = built.world_from_scan.inverse()
    summary = locate_queries(localizer, queries, lambda pose: scan_from_world @ pose, progress)
    return _answer_table(built.artifact.keyframe_count, summary)


def scan_of(video: FloorVideo) -> Scan:
    """Return the frames of the video with their true poses, and with depth where it was measured."""
    from bench.recordings.floor_video import FPS
    from bench.recordings.scan import SCAN_CAMERA

    files = zip(video.frames, video.depth or video.frames, video.world_from_camera, strict=True)
    frames = tuple(
        Frame(colour.name, number / FPS, colour, depth, pose)
        for number, (colour, depth, pose) in enumerate(files)
    )
    return Scan(
        camera=SCAN_CAMERA,
        frames=frames,
        discarded={},
        depth=DepthFormat(scale=1000.0),
        has_depth=bool(video.depth),
    )


def queries_of(video: FloorVideo) -> FormatQueries:
    """Return the phone pictures."""
    frames = tuple(Frame(q.name, 0.0, q.path, q.path, q.world_from_camera) for q in video.queries)
    scan = Scan(
        camera=video.queries[0].camera,
        frames=frames,
        discarded={},
        depth=DepthFormat(scale=1000.0),
        has_depth=False,
    )
    return FormatQueries(scan, frames)


def _map_table(result: UnposedResult, watched: WatchedProgress, length_s: float) -> Table:
    columns = (
        "video s",
        "pictures",
        "chosen",
        "connected",
        "other parts",
        "focal px",
        "scale %",
        "trajectory cm",
        "up deg",
        "build s",
        "build processor s",
        "peak GB",
        "longest s without a report",
    )
    report = result.report
    table = Table(*columns, title="The map, after one rigid alignment")
    table.add_row(
        f"{length_s:.0f}",
        *(str(report[name]) for name in ("pictures", "chosen", "connected")),
        ", ".join(str(part["frames"]) for part in report["other_parts"]) or "none",
        f"{result.camera.focal_px:.1f}",
        "no scale" if result.scale_error is None else f"{100 * result.scale_error:+.2f}",
        f"{result.trajectory_cm:.1f}",
        "not found" if result.up_error_deg is None else f"{result.up_error_deg:.1f}",
        f"{result.build_s:.0f}",
        f"{result.build_processor_s:.0f}",
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KB_PER_GB:.1f}",
        f"{watched.longest_s:.0f} ({watched.longest_in})",
    )
    return table


def _stage_table(watched: WatchedProgress) -> Table:
    table = Table("stage", "s", "processor s", title="Time of each stage, queries included")
    for stage, (clock_s, processor_s) in watched.stage_s.items():
        table.add_row(stage, f"{clock_s:.0f}", f"{processor_s:.0f}")
    return table


def _answer_table(keyframes: int, summary: ErrorSummary) -> Table:
    cells = {
        "keyframes": keyframes,
        "pictures": summary.queries,
        "located %": summary.located_percent,
        "within 25 cm %": summary.within_25cm_percent,
        "median cm": summary.median_cm or "none",
        "p90 cm": summary.p90_cm or "none",
        "median deg": summary.median_deg or "none",
        "wrong by over 0.5 m %": summary.gross_percent,
        "over 1 m %": summary.over_1m_percent,
    }
    table = Table(*cells, title="Phone pictures near the walk, by the map's own scale")
    table.add_row(*(str(value) for value in cells.values()))
    return table
