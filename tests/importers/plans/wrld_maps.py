"""A tiny indoor map in the WRLD format: two levels, a room and a corridor on each, stairs and a lift."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

LONGITUDE, LATITUDE = 8.0, 50.0
# Degrees of a metre there.
EAST, NORTH = 1 / 71_695.0, 1 / 111_229.0


def degrees(*points: tuple[float, float]) -> list[list[float]]:
    """Return longitudes and latitudes of points in metres."""
    return [[LONGITUDE + x * EAST, LATITUDE + y * NORTH] for x, y in points]


def room(room_id: int, name: str | None, kind: str, x: float, y: float) -> dict[str, Any]:
    """Return a square room of 4 m."""
    ring = degrees((x, y), (x + 4, y), (x + 4, y + 4), (x, y + 4), (x, y))
    return {
        "type": "Feature",
        "properties": {"id": room_id, "type": kind, "name": name},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def path(path_id: int, kind: str, *points: tuple[float, float], **more: object) -> dict[str, Any]:
    """Return a path."""
    return {
        "type": "Feature",
        "properties": {"id": path_id, "type": kind, "name": f"path {path_id}"},
        "geometry": {"type": "LineString", "coordinates": degrees(*points)},
        **more,
    }


def files() -> dict[str, Any]:
    """Return the JSON of each file of the map."""
    levels = [
        {
            "id": f"floor-{k}",
            "name": str(k),
            "readable_name": f"Level {k}",
            "z_order": k,
            "filename": f"l{k}.geojson",
        }
        for k in (1, 0)
    ]
    rooms = [[room(1, "Office", "room", 0, 2), room(2, None, "stairs", 10, 2), room(3, None, "wall", 0, 0)]]
    rooms.append(
        [room(4, "Lab", "unit", 0, 2), room(5, None, "stairs", 10, 2), room(6, "Lab", "no_geometry", 20, 2)]
    )
    paths = [
        [path(7, "pathway", (2, 4), (2, 0), (12, 0), (12, 4))],
        [path(8, "pathway", (12, 4), (12, 0), (2, 0), (2, 4))],
    ]
    between = [
        path(9, "stairs", (12, 4), (12, 4), levels=[0, 1]),
        path(10, "elevator", (8, 0), (8, 0), levels=[1, 0]),
    ]
    found: dict[str, Any] = {
        "main.json": {
            "id": "house",
            "name": "The house",
            "location": {"type": "Point", "coordinates": [LONGITUDE, LATITUDE]},
            "levels": levels,
        },
        "main-paths.json": {"features": between, "level_filenames": ["p0.geojson", "p1.geojson"]},
    }
    for k in (0, 1):
        found[f"l{k}.geojson"] = {"type": "FeatureCollection", "features": rooms[k]}
        found[f"p{k}.geojson"] = {"type": "FeatureCollection", "z_order": k, "features": paths[k]}
    return found


def write(folder: Path, values: dict[str, Any]) -> Path:
    """Write the files of a map; text as it is."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in values.items():
        (folder / name).write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return folder
