"""All formats of indoor maps: which one the files are in, and the map in them."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from app.errors import InvalidInputError
from app.importers.plans import wrld
from app.importers.plans.files import PlanFiles, open_plan_files
from app.importers.plans.imdf import reading as imdf
from app.importers.plans.model import IndoorMap
from app.importers.plans.osm import reading as osm


class PlanImporter(Protocol):
    """A format of indoor maps: the interface of the modules `wrld`, `imdf.reading` and `osm.reading`."""

    def detect(self, files: PlanFiles, /) -> bool:
        """Whether the files look like a map in this format."""

    def read(self, files: PlanFiles, /) -> IndoorMap:
        """Return the map; raises `InvalidInputError`."""


# In the order in which files are asked.
FORMATS: dict[str, PlanImporter] = {"wrld": wrld, "imdf": imdf, "osm": osm}


def read_indoor_map(path: Path, format_name: str | None = None) -> IndoorMap:
    """Return the indoor map in a folder, a zip or a file; raises `InvalidInputError`."""
    if format_name is not None and format_name not in FORMATS:
        raise InvalidInputError(f"The format must be one of {', '.join(FORMATS)}.")
    files = open_plan_files(path)
    chosen = format_name or next((name for name, one in FORMATS.items() if one.detect(files)), None)
    if chosen is None:
        shown = ", ".join(sorted(files.contents)[:6]) or "no JSON, GeoJSON or OSM file"
        raise InvalidInputError(
            f"{path.name} holds {shown}, which is no indoor map that is read. Known are WRLD (main.json), IMDF "
            "(manifest.json, level.geojson, unit.geojson) and OpenStreetMap (.osm, or GeoJSON with indoor tags)."
        )
    return FORMATS[chosen].read(files)
