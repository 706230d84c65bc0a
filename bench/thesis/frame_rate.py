"""Odometry after an anchor's last fix, at 60 and at 30 frames a second (C figure 6.6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from app.engine.anchors.features import AnchorDescriber
from app.engine.progress import Progress
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from bench.anchors.pairs import PairEvaluator
from bench.anchors.starts import Start, StartSettings, evaluate_starts
from bench.anchors.thesis import AnchorPipeline, run_thesis_session
from bench.recordings.filmed_walk import FPS, render_filmed_walk
from bench.recordings.scan import SCAN_CAMERA

DOWN = np.array([0.0, 0.0, -1.0])
# Every frame, and every second one.
STEPS = (1, 2)
SESSIONS = 4
# How long a monitoring camera sees the phone, and how long a session is in all.
ANCHORED_S = 0.5
SESSION_S = 2.0
POIS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class RateFigures:
    """Sessions that were tried and that went on after the last fix; their mean path there; mean, variance and 90th
    percentile of the errors of all their frames, and the mean of each session's last error, None without frames."""

    sessions: int
    went_on: int
    path_m: float | None
    mean_m: float | None
    variance_m2: float | None
    p90_m: float | None
    last_m: float | None


def measure_frame_rates(
    directory: Path,
    describers: Mapping[AnchorPipeline, AnchorDescriber],
    workers: int,
    progress: Progress,
) -> dict[tuple[float, str], RateFigures]:
    """Return the figures by frames a second and pipeline; the walk is rendered below the directory."""
    walk = render_filmed_walk(
        directory / "filmed-walk", SCAN_CAMERA, workers=workers,
        progress=lambda done, total: progress.report("render", done, total),
    )  # fmt: skip
    scan = open_scan(walk.scan.directory, None, ScanOptions())
    monitors, video = scan.frames[: walk.cameras], scan.frames[walk.cameras :]
    found = {}
    for step in STEPS:
        rate = FPS / step
        settings = StartSettings(
            starts=SESSIONS, frames=round(SESSION_S * rate), anchored=round(ANCHORED_S * rate), pois=POIS
        )
        for pipeline, describer in describers.items():
            run = run_thesis_session if pipeline is AnchorPipeline.THESIS else None
            outcomes = evaluate_starts(
                scan, monitors, video[::step], DOWN, settings, PairEvaluator(describer), progress, run
            )
            found[rate, pipeline.value] = rate_figures(outcomes)
    return found


def rate_figures(outcomes: Sequence[Start | str]) -> RateFigures:
    """Return the figures of some sessions."""
    starts = [each for each in outcomes if isinstance(each, Start)]
    errors = np.array([frame.error_m for start in starts for frame in start.frames])
    ends = [start.frames[-1] for start in starts]
    return RateFigures(
        sessions=len(outcomes),
        went_on=len(starts),
        path_m=round(float(np.mean([end.path_m for end in ends])), 2) if ends else None,
        mean_m=round(float(errors.mean()), 3) if ends else None,
        variance_m2=round(float(errors.var()), 4) if ends else None,
        p90_m=round(float(np.percentile(errors, 90)), 3) if ends else None,
        last_m=round(float(np.mean([end.error_m for end in ends])), 3) if ends else None,
    )


def frame_rate_table(rates: dict[tuple[float, str], RateFigures]) -> Table:
    """Return the table of the figures."""
    table = Table(
        "frames / s", "pipeline", "sessions", "went on", "path m", "mean m", "variance m2", "90 % m", "at the end m",
        title=f"Odometry after the last fix of {ANCHORED_S:g} s with a monitoring camera, up to "
        f"{SESSION_S - ANCHORED_S:g} s, 640 x 480",
    )  # fmt: skip
    for (rate, pipeline), of in rates.items():
        values = (of.path_m, of.mean_m, of.variance_m2, of.p90_m, of.last_m)
        cells = ["-" if value is None else f"{value:g}" for value in values]
        table.add_row(f"{rate:g}", pipeline, str(of.sessions), str(of.went_on), *cells)
    return table
