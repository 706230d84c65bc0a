"""`roomfix examine-mistakes`: everyday mistakes made on a right scan, and what its examination says of each."""

from __future__ import annotations

import json
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.commands.console import console, progress_bars
from app.engine.mapping.options import parse_build_options
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Dataset, JsonFile, Options
from bench.evaluation.dataset import parse_range
from bench.examination.mistakes import MISTAKES, Examined, examine_copy, right_variants
from bench.examination.repaired_maps import Located, locate_in_repaired
from bench.examination.scan_copy import ScanCopy
from bench.figures.shown import FiguresTitle, Shown

Run = tuple[Examined, Located | None]


def examine_mistakes(
    dataset: Dataset,
    frames: Annotated[str, typer.Option(help="Frames of the scan: start:stop:step, by order.")] = "0:60",
    queries: Annotated[
        str | None, typer.Option(help="Build the repaired maps, and locate these frames in them.")
    ] = None,
    gravity: Annotated[
        str | None, typer.Option(help="Down in the scan's frame, x,y,z, where the scan has no gravity.txt.")
    ] = None,
    only: Annotated[str | None, typer.Option(help="Only scans whose name holds this.")] = None,
    options: Options = "{}",
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Make every mistake on a scan and examine it; also right scans: thinned, noisy and of half resolution."""
    cap_threads()
    base = parse_build_options(json.loads(options))
    scan = open_scan(dataset, base.format, base.scan)
    down = None if gravity is None else parse_build_options({"gravity": json.loads(f"[{gravity}]")}).gravity
    trajectory = dataset / "groundtruth.txt"
    copy = ScanCopy.of(
        replace(scan, frames=scan.frames[parse_range(frames)]),
        down,
        trajectory if trajectory.is_file() else None,
    )
    asked = () if queries is None else scan.frames[parse_range(queries)]
    cases: list[tuple[str, ScanCopy, tuple[str, ...]]] = [
        (name, one, ()) for name, one in right_variants(copy)
    ]
    cases += [(mistake.name, mistake.make(copy), mistake.codes) for mistake in MISTAKES]
    runs: list[Run] = []
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        models = open_models(Settings()) if asked else None
        for name, changed, codes in cases:
            if only is not None and only not in name:
                continue
            with tempfile.TemporaryDirectory() as folder:
                found = examine_copy(name, changed, codes, Path(folder), executor, progress)
                located = None
                if models is not None and found.usable is not None:
                    located = locate_in_repaired(found.usable, scan, asked, models, executor, progress)
            runs.append((found, located))
            console.print(f"{name}: {found.verdict}, {'as it should' if found.named else 'NOT AS IT SHOULD'}")
    shown = Shown()
    shown.table(_table(dataset.name, runs))
    shown.write("examine-mistakes", figures_title)
    if json_file is not None:
        json_file.write_text(json.dumps([_as_dict(*run) for run in runs], indent=1))


def _table(name: str, runs: list[Run]) -> Table:
    table = Table(
        "scan", "verdict", "as it should", "findings", "seconds", "repaired: located, median cm, deg",
        title=f"{name}: {sum(run.named for run, _ in runs)} of {len(runs)} as they should",
    )  # fmt: skip
    for run, located in runs:
        table.add_row(
            run.name, run.verdict, "yes" if run.named else "NO", ", ".join(run.codes), f"{run.seconds:.1f}",
            "" if located is None else located.words,
        )  # fmt: skip
    return table


def _as_dict(run: Examined, located: Located | None) -> dict[str, Any]:
    return {
        "name": run.name,
        "verdict": run.verdict,
        "named": run.named,
        "codes": run.codes,
        "sentence": run.sentence,
        "seconds": run.seconds,
        "repairs": None if run.usable is None else run.usable.repairs_report().get("repairs"),
        "located": None if located is None else asdict(located),
    }
