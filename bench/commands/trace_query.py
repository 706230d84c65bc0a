"""`roomfix trace-query`: the way of one query through the modules of the product."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import DataDir, console, settings_from
from app.geometry.camera_hint import parse_camera_hint
from app.services.locate_result import LocateRequest
from app.services.resources import Resources
from app.services.wiring import wire_services
from bench.evaluation.call_path import trace


def trace_query(
    image: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="A photo of the venue.")],
    venue: Annotated[str | None, typer.Option(help="The venue, if there are several.")] = None,
    camera: Annotated[str | None, typer.Option(help="fx,fy,cx,cy, searched for if not given.")] = None,
    data_dir: DataDir = None,
    path: Annotated[bool, typer.Option("--path", help="Print every stay, in order.")] = False,
) -> None:
    """Locate a photo twice and print the second time's stays in modules, and returns to modules already left."""
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        service = wire_services(resources).locate
        request = LocateRequest(image=image.read_bytes(), venue=venue, camera=parse_camera_hint(camera))
        service.locate(request)
        found = trace(lambda: service.locate(request))
    finally:
        resources.close()
    if path:
        console.print("\n".join(found.stays))
    console.print(
        f"{len(found.stays)} stays in {found.modules} modules, {found.returns} returns to a module already left"
    )
