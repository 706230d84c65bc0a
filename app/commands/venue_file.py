"""`roomfix export-venue` and `roomfix import-venue`: one venue as a file, on a data folder."""

from __future__ import annotations

import os
import uuid
from pathlib import Path
from typing import Annotated

import typer

from app.api.bodies.report import BuildReport
from app.commands.console import DataDir, console, progress_bars, settings_from
from app.services.resources import Resources
from app.services.venue_files.export_venue import export_venue as open_venue_file
from app.services.venue_files.import_venue import import_venue as add_venue


def export_venue(
    venue: Annotated[str, typer.Argument(help="The venue.")],
    file: Annotated[
        Path, typer.Argument(dir_okay=False, help="The file to write; one that is there is replaced.")
    ],
    active: Annotated[bool, typer.Option("--active", help="Only the map version that serves.")] = False,
    data_dir: DataDir = None,
) -> None:
    """Write a venue with its floors, plans, features, cameras and maps into one file; the server may run."""
    resources = Resources.open(settings_from(data_dir=data_dir))
    partial = file.with_name(f"{file.name}.{uuid.uuid4().hex}")
    try:
        found = open_venue_file(resources, venue, active_only=active)
        with partial.open("wb") as writing, progress_bars() as bars:
            for chunk in found.chunks:
                writing.write(chunk)
                bars.report("export", writing.tell(), found.size)
            writing.flush()
            os.fsync(writing.fileno())
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)
        resources.close()
    console.print(f"Wrote venue {venue} to {file}, {found.size / 1e6:,.1f} MB.", soft_wrap=True)


def import_venue(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="A file that was exported.")],
    as_: Annotated[
        str | None, typer.Option("--as", help="Id of the venue, in place of the one in the file.")
    ] = None,
    data_dir: DataDir = None,
) -> None:
    """Add the venue of a file, verified whole before anything of it can be seen; the server may run."""
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        with file.open("rb") as reading:
            found = add_venue(resources, reading, BuildReport.model_validate, as_)
    finally:
        resources.close()
    console.print(
        f"Venue {found.venue.id}: {found.floors} floors, {found.maps} maps, {len(found.cameras)} cameras.",
        soft_wrap=True,
    )
    for old, new in found.cameras.items():
        if old != new:
            console.print(f"Camera {old} is {new} here, since its id is taken.", soft_wrap=True)
