"""`roomfix shared-builds`: how much faster a build is when several workers make it together."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.commands.build import ensure_venue, zip_folder
from app.commands.console import json_object, settings_from
from app.errors import RoomfixError
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.storage.builds import get_build
from app.storage.maps import get_map
from bench.figures.shown import FiguresTitle, Shown
from bench.server_process import ROOT, STOP_S

VENUE = "v"
# Workers that have just been started are ready once they use less than this share of a core for this time.
IDLE_SHARE = 0.05
IDLE_S = 2.0
POLL_S = 0.1
TICKS_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One build: its seconds in all and by stage, the processor's seconds of each worker, and the digest of the map."""

    workers: int
    seconds: float
    stages: dict[str, float]
    processor_s: tuple[float, ...]
    digest: str


def shared_builds(
    scan: Annotated[Path, typer.Argument(exists=True, help="The scan: a folder or an archive.")],
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    workers: Annotated[str, typer.Option(help="Numbers of workers, one build each.")] = "1,2",
    figures: FiguresTitle = None,
) -> None:
    """Build a scan by one worker with one thread, then by several that share the build, and compare."""
    runs = [_run(scan, json_object(options), int(number)) for number in workers.split(",")]
    shown = Shown()
    shown.table(_table(runs))
    shown.write("shared-builds", figures)


def _run(scan: Path, options: dict[str, Any], workers: int) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        data_dir = Path(folder) / "data"
        resources = Resources.open(settings_from(data_dir=data_dir))
        try:
            ensure_venue(resources, VENUE, VENUE)
            archive = zip_folder(scan, Path(folder) / "scan.zip") if scan.is_dir() else scan
            with _running(data_dir, workers) as processes:
                _wait_until_idle(processes)
                with archive.open("rb") as file:
                    build_id = submit_build(resources, VENUE, options, file)
                return _watched(resources, build_id, processes)
        finally:
            resources.close()


def _watched(resources: Resources, build_id: str, processes: list[subprocess.Popen[bytes]]) -> Run:
    """Wait for a build and return what it took; raises `RoomfixError` when it fails."""
    before_s = [_processor_s(each.pid) for each in processes]
    while True:
        time.sleep(POLL_S)
        with resources.database.read() as connection:
            build = get_build(connection, build_id)
        if build.ended:
            break
        if any(each.poll() is not None for each in processes):
            raise RoomfixError("A worker has ended by itself.")
    if build.map_version is None or build.started_at is None or build.finished_at is None:
        raise RoomfixError(f"The build has {build.state}: {build.error}")
    with resources.database.read() as connection:
        digest = get_map(connection, VENUE, build.map_version).artifact_blob
    return Run(
        workers=len(processes),
        seconds=(build.finished_at - build.started_at).total_seconds(),
        stages=dict((build.report or {})["seconds"]),
        processor_s=tuple(
            _processor_s(each.pid) - before for each, before in zip(processes, before_s, strict=True)
        ),
        digest=digest,
    )


@contextmanager
def _running(data_dir: Path, count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run workers of one thread each."""
    settings = {"ROOMFIX_WORKERS": "1", "ROOMFIX_SHARE_BUILDS": "true", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "app.cli", "worker", "--data-dir", str(data_dir)]
    processes = [
        subprocess.Popen(command, env={**os.environ, **settings})  # noqa: S603 - our own code
        for _ in range(count)
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait(STOP_S)


def _wait_until_idle(processes: list[subprocess.Popen[bytes]]) -> None:
    used_s, before_s = float("inf"), 0.0
    while used_s > IDLE_SHARE * IDLE_S or before_s == 0.0:
        time.sleep(IDLE_S)
        now_s = sum(_processor_s(each.pid) for each in processes)
        used_s, before_s = now_s - before_s, now_s


def _processor_s(pid: int) -> float:
    """Return the processor's seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


def _table(runs: list[Run]) -> Table:
    first = runs[0]
    table = Table("workers", *(str(run.workers) for run in runs))
    for stage in first.stages:
        table.add_row(f"{stage}, s", *(f"{run.stages.get(stage, 0.0):.1f}" for run in runs))
    table.add_row("the whole build, s", *(f"{run.seconds:.1f}" for run in runs))
    table.add_row("times as fast as the first", *(f"{first.seconds / run.seconds:.2f}" for run in runs))
    table.add_row("processor of all workers, s", *(f"{sum(run.processor_s):.1f}" for run in runs))
    table.add_row("processor of the busiest worker, s", *(f"{max(run.processor_s):.1f}" for run in runs))
    # What several workers reach where each has a core of its own: other work on the machine hardly changes it.
    table.add_row(
        "times as fast by the busiest worker",
        *(f"{max(first.processor_s) / max(run.processor_s):.2f}" for run in runs),
    )
    table.add_row("the same map", *("yes" if run.digest == first.digest else "no" for run in runs))
    return table
