"""`roomfix import-plan`: an indoor map of another format becomes a venue."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.commands.console import DataDir, JsonFlag, console, settings_from
from app.engine.navigation.survey import Survey, survey
from app.importers.plans.model import IndoorMap
from app.importers.plans.registry import FORMATS, read_indoor_map
from app.services.floor_features import FeatureLibrary
from app.services.plans.import_plan import STOREY_M, import_indoor_map
from app.services.resources import Resources
from app.services.routes import RouteService

FORMAT_HELP = f"{', '.join(FORMATS)}; recognised if not given."


def import_plan(
    source: Annotated[Path, typer.Argument(exists=True, help="The map: a folder, a zip or a file.")],
    venue: Annotated[str, typer.Option(help="The venue; made if it is not there.")],
    format_name: Annotated[str | None, typer.Option("--format", help=FORMAT_HELP)] = None,
    storey_m: Annotated[
        float, typer.Option(min=1.0, max=50.0, help="Height of a storey where the map doesn't state it.")
    ] = STOREY_M,
    data_dir: DataDir = None,
    as_json: JsonFlag = False,
) -> None:
    """Make a venue with floors, areas, landmarks and links from an indoor map, and say what routes join."""
    indoor_map = read_indoor_map(source, format_name)
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        import_indoor_map(resources, venue, indoor_map, storey_m)
        routes = RouteService(resources.database, FeatureLibrary(resources.database))
        found = survey(routes.network(venue))
    finally:
        resources.close()
    if as_json:
        console.print_json(json.dumps({**asdict(found), **_described(indoor_map)}))
        return
    console.print(_table(f"{indoor_map.name} ({indoor_map.format}), venue {venue}", found))
    drawn = f" ({indoor_map.drawn} of them made from the rooms' shapes)" if indoor_map.drawn else ""
    console.print(f"Paths: {indoor_map.paths}{drawn}, ways between floors that meet nothing: {found.unmet}")
    console.print(f"Connected parts: {len(found.parts)}, with {', '.join(map(str, found.parts))} landmarks")
    console.print(f"Pairs of landmarks with a route: {_share(*found.landmark_pairs)}")
    console.print(f"Pairs of areas with a route: {_share(found.routed_pairs, found.pairs)}")
    left_out = ", ".join(f"{count} {kind}" for kind, count in indoor_map.left_out.items())
    console.print(f"Left out: {left_out or 'nothing'}")
    if indoor_map.origin is not None:
        console.print("Plan (0, 0) lies at longitude {:.7f}, latitude {:.7f}".format(*indoor_map.origin))


def _described(indoor_map: IndoorMap) -> dict[str, Any]:
    return {
        "name": indoor_map.name,
        "format": indoor_map.format,
        "paths": indoor_map.paths,
        "drawn": indoor_map.drawn,
        "left_out": dict(indoor_map.left_out),
        "origin": indoor_map.origin,
    }


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / max(whole, 1):.1f} %)"


def _table(title: str, found: Survey) -> Table:
    table = Table("floor", "name", "areas", "of these on a link", "landmarks", "links", title=title)
    for floor in found.floors:
        counts = floor.areas, floor.joined_areas, floor.landmarks, floor.links
        table.add_row(floor.id, floor.name, *map(str, counts))
    return table
