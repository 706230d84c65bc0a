"""`roomfix large-builds`: what a frame of a build costs, of a short scan and of a long one."""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.build_map import build_map
from app.engine.mapping.keyframe_rule import parse_keyframe_rule
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.mapping.self_check import check_map
from app.errors import InvalidInputError
from app.importers.frames import Scan
from app.importers.registry import open_scan
from app.services.resources import cap_threads
from bench.evaluation.dataset import parse_range
from bench.figures.shown import FiguresTitle, Shown
from bench.large_maps.copied_scan import CopiedModels, CopiedScan, CopyOfThread

# Every frame is a keyframe.
ALL_FRAMES = {"rule": "interval", "every": 1}
# Of the largest resident memory on Linux, a GB.
KB_PER_GB = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildCost:
    """A build with its self-check: keyframes, seconds, those of the processor, the largest memory of this process until
    its end in GB, and the seconds of each stage."""

    keyframes: int
    seconds: float
    processor_s: float
    peak_gb: float
    stages_s: dict[str, float]


def large_builds(
    scan: Annotated[Path, typer.Argument(exists=True, help="The folder of a scan with depth.")],
    frames: Annotated[
        str, typer.Option(help="Its frames of which a copy is made: start:stop:step.")
    ] = "::10",
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    copies: Annotated[str, typer.Option(help="Numbers of copies, one build each, growing.")] = "20,200",
    workers: Annotated[int, typer.Option(min=1, help="Threads of a build.")] = 2,
    figures_title: FiguresTitle = None,
) -> None:
    """Build maps of copies of a scan, each of which looks different, and print the time of a frame."""
    cap_threads()
    rule = parse_keyframe_rule(ALL_FRAMES)
    parsed = replace(parse_build_options(json.loads(options)), keyframes=rule, second_features=False)
    whole = open_scan(scan, parsed.format, parsed.scan)
    part = replace(whole, frames=whole.frames[parse_range(frames)])
    if not part.frames:
        raise InvalidInputError(f"--frames {frames} leaves no frame of {len(whole.frames)}.")
    costs = [_built(part, int(number), parsed, workers) for number in copies.split(",")]
    shown = Shown()
    shown.table(_table(costs))
    shown.write("large-builds", figures_title)


def _built(scan: Scan, copies: int, options: BuildOptions, workers: int) -> BuildCost:
    """Build a map of copies of a scan, and let it check itself."""
    copy = CopyOfThread()
    source, models = CopiedScan(scan, copies, copy), CopiedModels(copy)
    began, began_processor = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(workers) as executor, progress_bars() as progress:
        built = build_map(source, options, models, executor, progress)
        checked = time.perf_counter()
        check_map(built, source, models, executor, progress)
    ended = time.perf_counter()
    return BuildCost(
        keyframes=len(built.keyframes),
        seconds=ended - began,
        processor_s=time.process_time() - began_processor,
        peak_gb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KB_PER_GB,
        stages_s={**built.seconds, "verify": ended - checked},
    )


def _table(costs: Sequence[BuildCost]) -> Table:
    first = costs[0]
    table = Table("keyframes", *(f"{cost.keyframes:,}" for cost in costs))
    table.add_row("the whole build, s", *(f"{cost.seconds:.0f}" for cost in costs))
    table.add_row("a frame, ms", *(f"{1e3 * cost.seconds / cost.keyframes:.1f}" for cost in costs))
    table.add_row(
        "a frame, of the first",
        *(f"{cost.seconds * first.keyframes / cost.keyframes / first.seconds:.2f}" for cost in costs),
    )
    table.add_row(
        "a frame, ms of processor", *(f"{1e3 * cost.processor_s / cost.keyframes:.1f}" for cost in costs)
    )
    table.add_row(
        "a frame's processor, of the first",
        *(f"{cost.processor_s * first.keyframes / cost.keyframes / first.processor_s:.2f}" for cost in costs),
    )
    for stage in first.stages_s:
        table.add_row(
            f"{stage}, ms a frame", *(f"{1e3 * cost.stages_s[stage] / cost.keyframes:.1f}" for cost in costs)
        )
    table.add_row("largest memory, GB", *(f"{cost.peak_gb:.1f}" for cost in costs))
    return table
