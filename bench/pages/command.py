"""`roomfix evaluate-phone-page`: the phone page in Chromium with a rendered walk as its camera."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Annotated

import httpx
import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from bench.commands.demo import DEFAULT_DIR
from bench.demo import VENUE
from bench.figures.shown import FiguresTitle, Shown
from bench.pages.phone_page import PhonePageReport, phone_page, record_walk, report_of
from bench.recordings.phone_walk import PhoneWalk, render_phone_walk
from bench.server_process import server_process

# Frames of the walk that are asked for one by one, to compare with what the page takes.
SINGLE_EVERY = 24


def evaluate_phone_page(
    data_dir: Annotated[Path, typer.Option(help="The folder of `roomfix demo`.")] = DEFAULT_DIR,
    walk_dir: Annotated[
        Path | None, typer.Option(help="Where the walk is rendered; default: in the data folder.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Write a picture of the page here.")] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Let the phone page follow a rendered walk through the demonstration venue, at a first and at a second visit.

    The second visit knows the phone's focal length from the first.
    """
    with progress_bars() as bars:
        walk = render_phone_walk(
            walk_dir or data_dir / "phone-walk",
            progress=lambda done, total: bars.report("render", done, total),
        )
    with tempfile.TemporaryDirectory() as folder, server_process(data_dir, Path(folder) / "log") as server:
        single_ms = locate_ms(server.url, walk)
        with phone_page(walk) as page:
            reports = [report_of(record_walk(page, server.url, walk, picture), walk) for _ in range(2)]
    shown = Shown()
    shown.table(_table(reports))
    shown.line(
        f"`/locate` takes {np.median(single_ms):.0f} ms for a frame of this walk in the same run (median of "
        f"{len(single_ms)}; the longest {max(single_ms):.0f} ms), without intrinsics."
    )
    shown.write("evaluate-phone-page", figures_title)


def locate_ms(address: str, walk: PhoneWalk) -> list[float]:
    """Return how long single frames of the walk take by `/locate`; the first one, which opens the map, is left out."""
    times = []
    for path in walk.frames[::SINGLE_EVERY]:
        began = time.perf_counter()
        httpx.post(
            f"{address}/locate", data={"venue": VENUE.id}, files={"image": path.read_bytes()}, timeout=120
        ).raise_for_status()
        times.append(1000 * (time.perf_counter() - began))
    return times[1:]


def _table(reports: list[PhonePageReport]) -> Table:
    table = Table(
        "visit", "first answer s", "answers a second", "answer ms", "fresh dot %", "dot m (median, 90 %, largest)",
        "dot against now m (median, 90 %, largest)", "arrived",
    )  # fmt: skip
    for visit, report in zip(("first", "second"), reports, strict=True):
        table.add_row(
            visit,
            f"{report.first_answer_s:.2f}",
            f"{report.answers_per_s:.1f}",
            f"{report.answer_ms:.0f}",
            f"{100 * report.located_ratio:.0f}",
            _errors(report.frame_errors_m),
            _errors(report.present_errors_m),
            "yes" if report.arrived else "no",
        )
    return table


def _errors(errors_m: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    if not len(errors_m):
        return "none"
    return ", ".join(f"{value:.2f}" for value in np.percentile(errors_m, [50, 90, 100]))
