"""`roomfix upload-bench`: a large file over a connection that breaks, and what it takes of the server."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from bench.figures.shown import FiguresTitle, Shown
from bench.server_process import server_process
from bench.uploads.measure import UploadCost, make_file, measure_upload


def upload_bench(
    megabytes: Annotated[int, typer.Option(min=1, help="Size of the file.")] = 2000,
    cuts: Annotated[int, typer.Option(min=0, help="Times that the connection breaks.")] = 20,
    scratch: Annotated[
        Path | None, typer.Option(help="Folder on a disk with three times the file's size.")
    ] = None,
    figures: FiguresTitle = None,
) -> None:
    """Upload a file to a server of its own through a proxy that breaks the connection; print memory and disk."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        file, data_dir = Path(folder) / "scan.zip", Path(folder) / "data"
        digest = make_file(file, megabytes)
        with server_process(data_dir, Path(folder) / "log") as server:
            cost = measure_upload(server.url, server.pid, server.data_dir, file, digest, cuts)
    shown = Shown()
    shown.table(_table(cost))
    shown.write("upload-bench", figures)


def _table(cost: UploadCost) -> Table:
    table = Table("upload", "value")
    table.add_row("megabytes", f"{cost.megabytes:,.0f}")
    table.add_row("times the connection broke", str(cost.cuts))
    table.add_row("seconds", f"{cost.seconds:.1f}")
    table.add_row("arrived whole", "yes" if cost.is_whole else "no")
    table.add_row("server memory above idle, MB", f"{cost.memory_above_idle_mb:.0f}")
    table.add_row("disk beside the store, times the file", f"{cost.disk_ratio:.2f}")
    return table
