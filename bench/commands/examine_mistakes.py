"""`roomfix examine-mistakes`: everyday mistakes made on a right scan, and what its examination says of each."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import console, progress_bars
from app.engine.mapping.options import parse_build_options
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.commands.evaluate import Dataset, JsonFile, Options
from bench.evaluation.dataset import parse_range
from bench.examination.mistakes import MISTAKES, examine_copy, right_variants
from bench.examination.repaired_maps import RepairedMaps
from bench.examination.rows import RIGHT, Record, Row, summary
from bench.examination.scan_copy import ScanCopy
from bench.figures.provenance import ROOT, commit_of
from bench.figures.shown import FiguresTitle, Shown


def examine_mistakes(
    dataset: Dataset,
    frames: Annotated[str, typer.Option(help="Frames of the scan: start:stop:step, by order.")] = "0:60",
    queries: Annotated[
        str | None,
        typer.Option(help="Build the repaired maps, and locate these frames in them: no scan has them."),
    ] = None,
    gravity: Annotated[
        str | None, typer.Option(help="Down in the scan's frame, x,y,z, where the scan has no gravity.txt.")
    ] = None,
    only: Annotated[str | None, typer.Option(help="Only scans whose name holds this.")] = None,
    part_minutes: Annotated[
        float,
        typer.Option(help="Begin no further scan after this time; the same --json file is gone on with."),
    ] = math.inf,
    options: Options = "{}",
    json_file: JsonFile = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Make every mistake on a scan and examine it; also right scans: thinned, noisy and of half resolution."""
    cap_threads()
    until = time.monotonic() + 60.0 * part_minutes
    base = parse_build_options(json.loads(options))
    scan = open_scan(dataset, base.format, base.scan)
    down = None if gravity is None else parse_build_options({"gravity": json.loads(f"[{gravity}]")}).gravity
    trajectory = dataset / "groundtruth.txt"
    asked = () if queries is None else scan.frames[parse_range(queries)]
    left_out = {frame.name for frame in asked}
    used = tuple(frame for frame in scan.frames[parse_range(frames)] if frame.name not in left_out)
    copy = ScanCopy.of(replace(scan, frames=used), down, trajectory if trajectory.is_file() else None)
    arguments = {"data": dataset.name, "frames": frames, "queries": queries, "gravity": gravity}
    record = Record.at(json_file, {**arguments, "options": options})
    commit = commit_of(ROOT)
    with ThreadPoolExecutor(Settings().workers) as executor, progress_bars() as progress:
        models = open_models(Settings()) if asked else None
        maps = _maps_before(copy, record, executor)
        for name, changed, codes in _cases(copy):
            if (only is not None and only not in name) or name in record.rows or time.monotonic() > until:
                continue
            with tempfile.TemporaryDirectory() as folder:
                found = examine_copy(name, changed, codes, Path(folder), executor, progress)
                located = None
                if models is not None and found.usable is not None:
                    located = maps.locate(name, found.usable, scan, asked, models, executor, progress)
            record.add(Row.of(found, located, bool(codes), commit))
            console.print(f"{name}: {found.verdict}, {'as it should' if found.named else 'NOT AS IT SHOULD'}")
    rows = [record.rows[name] for name, _, _ in _cases(copy) if name in record.rows]
    shown = Shown()
    shown.table(_table(dataset.name, rows))
    for line in summary(rows, commit):
        shown.line(line)
    shown.write("examine-mistakes", figures_title)


def _maps_before(copy: ScanCopy, record: Record, executor: Executor) -> RepairedMaps:
    """Return the right scan's map if an earlier part of the measurement asked it: most repaired scans equal it."""
    maps = RepairedMaps()
    right = record.rows.get(RIGHT)
    if right is not None and right.located is not None:
        with tempfile.TemporaryDirectory() as folder:
            options = parse_build_options(copy.write(Path(folder)))
            scan = open_scan(Path(folder), options.format, options.scan)
            maps.know(RIGHT, scan, options, right.located, executor)
    return maps


def _cases(copy: ScanCopy) -> Iterator[tuple[str, ScanCopy, tuple[str, ...]]]:
    """Yield names of scans, the scans and the codes of findings that name their mistake, none for right ones."""
    yield from ((name, one, ()) for name, one in right_variants(copy))
    yield from ((mistake.name, mistake.make(copy), mistake.codes) for mistake in MISTAKES)


def _table(name: str, rows: Sequence[Row]) -> Table:
    table = Table(
        "scan", "verdict", "as it should", "findings", "seconds", "map after repair: located, median error",
        title=f"{name}: {sum(row.named for row in rows)} of {len(rows)} as they should",
    )  # fmt: skip
    for row in rows:
        table.add_row(
            row.name, row.verdict, "yes" if row.named else "NO", ", ".join(row.codes), f"{row.seconds:.1f}",
            _located_words(row),
        )  # fmt: skip
    return table


def _located_words(row: Row) -> str:
    if row.located is None:
        return ""
    same = row.located.same_as
    return row.located.words + (f" (the same scan as: {same})" if same is not None else "")
