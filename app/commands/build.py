"""`roomfix build`, `roomfix locate` and `roomfix sweep`: on a data folder, with or without a server."""

from __future__ import annotations

import json
import tempfile
import zipfile
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.api.locate import body_of
from app.commands.console import (
    BarProgress,
    DataDir,
    JsonFlag,
    console,
    json_object,
    progress_bars,
    settings_from,
)
from app.errors import ConflictError, RoomfixError
from app.geometry.camera_hint import parse_camera_hint
from app.importers.archives.archive import is_named, is_read
from app.jobs.local import finish_build_here
from app.services.locate_result import LocateRequest
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.services.wiring import wire_services
from app.storage.builds import Build
from app.storage.sweep import GRACE, sweep_blobs
from app.storage.venues import create_venue
from app.vision.image_files.formats import FORMATS_IN_WORDS


def build(
    scan: Annotated[Path, typer.Argument(exists=True, help="The scan: a folder, zip, tar or recording.")],
    venue: Annotated[str, typer.Option(help="The venue; made if it is not there.")],
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    data_dir: DataDir = None,
    as_json: JsonFlag = False,
) -> None:
    """Build a map from an RGB-D scan."""
    resources = Resources.open(settings_from(data_dir=data_dir), is_patient=True)
    try:
        ensure_venue(resources, venue, venue)
        with progress_bars() as progress:
            ended = build_scan(resources, venue, scan, json_object(options), progress)
    finally:
        resources.close()
    if as_json:
        console.print_json(json.dumps(ended.report))
        return
    report = ended.report or {}
    console.print(f"Map version {ended.map_version} of venue {venue} serves.")
    console.print(_report_table(report))


def build_scan(
    resources: Resources, venue: str, scan: Path, options: dict[str, Any], progress: BarProgress
) -> Build:
    """Submit a scan, a folder or an archive, and see its build through; raises `RoomfixError` if it fails."""
    with tempfile.TemporaryDirectory(dir=resources.scratch_dir) as folder:
        archive = zip_folder(scan, Path(folder) / "scan.zip") if scan.is_dir() else scan
        with archive.open("rb") as file:
            build_id = submit_build(resources, venue, options, file)

    def watch(build: Build) -> None:
        if build.stage is not None and build.state == "running":
            progress.report(build.stage, build.done, build.total)

    ended = finish_build_here(resources, build_id, watch)
    if ended.state != "succeeded":
        raise RoomfixError(f"The build has {ended.state}: {ended.error or 'no reason given'}")
    return ended


def zip_folder(folder: Path, target: Path) -> Path:
    """Write the files of a scan's folder to a zip, stored as they are: images don't shrink."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder)
            if path.is_file() and is_read(name):
                archive.write(path, name)
            elif path.is_file() and is_named(name):
                archive.writestr(name.as_posix(), b"")
    return target


def locate(
    image: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help=f"{FORMATS_IN_WORDS}.")],
    venue: Annotated[str | None, typer.Option(help="May be left out when there is one venue.")] = None,
    floor: Annotated[str | None, typer.Option(help="Search this floor first.")] = None,
    area: Annotated[str | None, typer.Option(help="Search this area first: its id or name.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="fx,fy,cx,cy[,k1,k2,p1,p2[,k3]], searched for if not given.")
    ] = None,
    data_dir: DataDir = None,
) -> None:
    """Locate a photo; prints the answer of POST /locate."""
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        request = LocateRequest(
            image=image.read_bytes(), venue=venue, floor=floor, camera=parse_camera_hint(camera), area=area
        )
        result = wire_services(resources).locate.locate(request)
    finally:
        resources.close()
    console.print_json(body_of(result).model_dump_json())


def sweep(
    grace_hours: Annotated[float, typer.Option(min=0, help="Keep what is younger than this.")] = (
        GRACE.total_seconds() / 3600
    ),
    data_dir: DataDir = None,
) -> None:
    """Delete blobs that nothing refers to (the server does so by itself, hourly)."""
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        count = sweep_blobs(resources.database, resources.blobs, timedelta(hours=grace_hours))
    finally:
        resources.close()
    console.print(f"{count} orphaned files deleted.")


def ensure_venue(resources: Resources, venue: str, name: str) -> None:
    """Add a venue unless it is there."""
    try:
        with resources.database.write() as connection:
            create_venue(connection, venue, name)
    except ConflictError:
        return


def _report_table(report: dict[str, Any]) -> Table:
    table = Table(show_header=False)
    for name in ("repaired", "warnings"):
        if report.get(name):
            table.add_row(name, json.dumps(report[name]))
    for name in (
        "frames",
        "discarded",
        "replaced",
        "keyframes",
        "features",
        "bytes",
        "seconds",
        "placement",
        "examination",
        "self_check",
    ):
        table.add_row(name, json.dumps(report.get(name)))
    return table
