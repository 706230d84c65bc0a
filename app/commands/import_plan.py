"""`roomfix import-plan`: an indoor map of another format becomes a venue."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import DataDir, JsonFlag, console, settings_from
from app.engine.navigation.survey import Survey, survey
from app.importers.wrld_indoor_map import read_indoor_map
from app.services.floor_features import FeatureLibrary
from app.services.import_plan import STOREY_M, import_indoor_map
from app.services.resources import Resources
from app.services.routes import RouteService


def import_plan(
    folder: Annotated[
        Path, typer.Argument(exists=True, file_okay=False, help="A map in the WRLD Indoor Map Format.")
    ],
    venue: Annotated[str, typer.Option(help="The venue; made if it is not there.")],
    storey_m: Annotated[
        float, typer.Option(min=1.0, max=50.0, help="Height of a storey, which the format doesn't hold.")
    ] = STOREY_M,
    data_dir: DataDir = None,
    as_json: JsonFlag = False,
) -> None:
    """Make a venue with floors, areas, landmarks and links from an indoor map, and say what routes join."""
    indoor_map = read_indoor_map(folder)
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        import_indoor_map(resources, venue, indoor_map, storey_m)
        routes = RouteService(resources.database, FeatureLibrary(resources.database))
        found = survey(routes.network(venue))
    finally:
        resources.close()
    if as_json:
        console.print_json(json.dumps(asdict(found)))
        return
    console.print(_table(f"{indoor_map.name}, venue {venue}", found))
    console.print(f"Paths: {indoor_map.paths}, ways between floors that meet nothing: {found.unmet}")
    console.print(f"Connected parts: {len(found.parts)}, with {', '.join(map(str, found.parts))} landmarks")
    console.print(f"Pairs of landmarks with a route: {_share(*found.landmark_pairs)}")
    console.print(f"Pairs of areas with a route: {_share(found.routed_pairs, found.pairs)}")


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / max(whole, 1):.1f} %)"


def _table(title: str, found: Survey) -> Table:
    table = Table("floor", "name", "areas", "of these on a link", "landmarks", "links", title=title)
    for floor in found.floors:
        counts = floor.areas, floor.joined_areas, floor.landmarks, floor.links
        table.add_row(floor.id, floor.name, *map(str, counts))
    return table
