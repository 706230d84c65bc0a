"""Indoor maps in the WRLD Indoor Map Format 1.0: `main.json`, a GeoJSON file a level, and optional paths.

Rooms become areas, paths become links, and every loose end of a path becomes a landmark named after the room that it
ends in. Walls, doors and windows have no meaning for a route and are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import PurePath
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.geometry.geodesy import east_north_from_geodetic
from app.importers.plans.files import PlanFiles
from app.importers.plans.finish import FLOOR_ID, OPTIONS, free_id, geojson_feature, slug
from app.importers.plans.model import MODE_WORDS, GeoJson, IndoorLevel, IndoorMap

# What an area is called where it has no name; types without a word here need one.
AREA_WORDS = {
    "room": "Room", "bathroom": "Bathroom", "hallway": "Hallway", "unit": "Unit", "garden": "Garden",
    "stairs": "Stairs", "elevator": "Lift", "escalator": "Escalator", "no_geometry": "",
}  # fmt: skip
WAY_MODES = {"stairs": "stairs", "elevator": "lift", "escalator": "escalator"}


def detect(files: PlanFiles) -> bool:
    """Whether the files are a map in this format."""
    return "main.json" in files.contents


def read(files: PlanFiles) -> IndoorMap:
    """Return the indoor map; raises `InvalidInputError` that names the file."""
    main = _read(files, "main.json")
    longitude, latitude = _location(main)
    origin = {"longitude": longitude, "latitude": latitude}
    levels = sorted(_objects(main, "levels", "main.json"), key=lambda level: _whole(level, "z_order"))
    orders = [_whole(level, "z_order") for level in levels]
    if not levels or len(set(orders)) != len(orders):
        raise InvalidInputError("main.json must list one level or more, each with a z_order of its own.")
    floor_ids = dict(zip(orders, _floor_ids(levels), strict=True))
    paths, ways = _paths(files, floor_ids)
    found = []
    left_out: Counter[str] = Counter()
    for level, order in zip(levels, orders, strict=True):
        own = _read(files, str(level.get("filename")))
        drawn = _objects(own, "features", str(level["filename"]))
        areas = list(_areas(drawn))
        left_out.update(kind for kind, _ in map(_kind, drawn) if kind not in AREA_WORDS)
        links = [*paths[order], *ways[order]]
        marks = list(_landmarks(paths[order], ways[order], areas, (longitude, latitude)))
        collection = {"type": "FeatureCollection", "origin": origin, "features": [*areas, *marks, *links]}
        name = level.get("readable_name") or level.get("name") or floor_ids[order]
        found.append(IndoorLevel(id=floor_ids[order], name=str(name), order=order, features=collection))
    count = sum(map(len, paths.values())) + sum(map(len, ways.values()))
    known = str(main.get("id") or files.name)
    return IndoorMap(
        id=known,
        name=str(main.get("name") or known),
        format="WRLD",
        levels=tuple(found),
        paths=count,
        left_out=dict(sorted(left_out.items())),
        origin=(longitude, latitude),
    )


def _read(files: PlanFiles, name: str) -> Mapping[str, Any]:
    if PurePath(name).name != name or name.startswith((".", "_")):
        raise InvalidInputError(f"{name!r} is no file name of an indoor map.")
    return files.json(name)


def _objects(value: Mapping[str, Any], key: str, name: str) -> list[Mapping[str, Any]]:
    entries = value.get(key)
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise InvalidInputError(f"{name} has no list of {key}.")
    return entries


def _location(main: Mapping[str, Any]) -> tuple[float, float]:
    location = main.get("location")
    coordinates = location.get("coordinates") if isinstance(location, Mapping) else None
    try:
        longitude, latitude = (float(value) for value in coordinates or ())
    except (TypeError, ValueError):
        raise InvalidInputError(
            "main.json needs location, a GeoJSON Point in longitude and latitude."
        ) from None
    return longitude, latitude


def _whole(value: Mapping[str, Any], key: str) -> int:
    number = value.get(key)
    if isinstance(number, bool) or not isinstance(number, int):
        raise InvalidInputError(f"Each level in main.json needs {key}, a whole number.")
    return number


def _floor_ids(levels: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the levels' short names where they can be ids, else their ids."""
    for key in ("name", "id"):
        names = [str(level.get(key)) for level in levels]
        if len(set(names)) == len(names) and all(map(FLOOR_ID.fullmatch, names)):
            return names
    raise InvalidInputError("The levels in main.json need ids of letters, digits and -._ that differ.")


def _kind(feature: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    properties = feature.get("properties")
    values = properties if isinstance(properties, Mapping) else {}
    return str(values.get("type")), values


def _areas(features: list[Mapping[str, Any]]) -> Iterator[GeoJson]:
    for feature in features:
        kind, properties = _kind(feature)
        word = AREA_WORDS.get(kind)
        name = properties.get("name") or word
        if word is not None and name:
            own = str(properties.get("id", name))
            yield geojson_feature("area", feature.get("geometry"), id=own, name=str(name), category=kind)


Links = dict[int, list[GeoJson]]


def _paths(files: PlanFiles, floor_ids: dict[int, str]) -> tuple[Links, Links]:
    """Return each level's paths, and the ways that begin there and lead to other levels."""
    paths: Links = {order: [] for order in floor_ids}
    ways: Links = {order: [] for order in floor_ids}
    if "main-paths.json" not in files.contents:
        return paths, ways
    main = _read(files, "main-paths.json")
    names = main.get("level_filenames")
    for name in names if isinstance(names, list) else []:
        level = _read(files, str(name))
        order = level.get("z_order")
        if order not in paths:
            raise InvalidInputError(f"{name} is for z_order {order!r}, which main.json doesn't list.")
        for feature in _objects(level, "features", str(name)):
            _, properties = _kind(feature)
            known = f"path-{properties.get('id', len(paths[order]))}"
            paths[order].append(
                geojson_feature(
                    "link", feature.get("geometry"), id=known, name=properties.get("name"), mode="walk"
                )
            )
    for feature in _objects(main, "features", "main-paths.json"):
        for order, way in _ways(feature, floor_ids):
            ways[order].append(way)
    return paths, ways


def _ways(feature: Mapping[str, Any], floor_ids: dict[int, str]) -> Iterator[tuple[int, GeoJson]]:
    """Yield a link for each change of level along a path between levels."""
    kind, properties = _kind(feature)
    levels, geometry = feature.get("levels"), feature.get("geometry")
    positions = geometry.get("coordinates") if isinstance(geometry, Mapping) else None
    if not isinstance(levels, list) or not isinstance(positions, list) or len(levels) != len(positions):
        raise InvalidInputError("main-paths.json: each path needs levels, one for each of its coordinates.")
    if kind not in WAY_MODES or not all(level in floor_ids for level in levels):
        raise InvalidInputError(
            f"main-paths.json: a path between levels is {', '.join(WAY_MODES)}, on levels of main.json."
        )
    for row, (a, b) in enumerate(pairwise(levels)):
        if a != b:
            line = {"type": "LineString", "coordinates": positions[row : row + 2]}
            known = f"way-{properties.get('id')}-{row}"
            name, mode = properties.get("name"), WAY_MODES[kind]
            yield a, geojson_feature("link", line, id=known, name=name, mode=mode, to_floor=floor_ids[b])


def _landmarks(
    paths: list[GeoJson], ways: list[GeoJson], areas: list[GeoJson], origin: tuple[float, float]
) -> Iterator[GeoJson]:
    """Yield a landmark for each end of a path that no other path touches, and where ways to other levels begin."""
    try:
        lines = [_metres(path["geometry"]["coordinates"], origin) for path in paths]
        rooms = [
            (shapely.Polygon(_metres(area["geometry"]["coordinates"][0], origin)), area["properties"]["name"])
            for area in areas
        ]
    except (KeyError, TypeError, ValueError, IndexError, shapely.errors.ShapelyError):
        raise InvalidInputError("A room or path of the indoor map has no valid GeoJSON geometry.") from None
    tree = shapely.STRtree(lines)
    loose: list[tuple[list[float], str]] = []
    for own, path in enumerate(paths):
        for position in (path["geometry"]["coordinates"][0], path["geometry"]["coordinates"][-1]):
            near = tree.query(_point(position, origin), predicate="dwithin", distance=OPTIONS.same_point_m)
            if set(near.tolist()) <= {own}:
                loose.append((position, path["properties"].get("name") or "Path"))
    for way in ways:
        loose.append((way["geometry"]["coordinates"][0], MODE_WORDS[way["properties"]["mode"]]))
    taken: set[str] = set()
    placed: list[shapely.Point] = []
    for position, fallback in loose:
        here = _point(position, origin)
        if any(here.distance(other) <= OPTIONS.same_point_m for other in placed):
            continue
        placed.append(here)
        name = min(((p.area, name) for p, name in rooms if p.intersects(here)), default=(0, fallback))[1]
        landmark_id = free_id(slug(name), taken)
        yield geojson_feature(
            "landmark", {"type": "Point", "coordinates": position}, id=landmark_id, name=name
        )


def _point(position: Any, origin: tuple[float, float]) -> shapely.Point:
    return shapely.Point(_metres([position, position], origin).coords[0])


def _metres(positions: Any, origin: tuple[float, float]) -> shapely.LineString:
    degrees = np.array([position[:2] for position in positions], dtype=np.float64)
    return shapely.LineString(east_north_from_geodetic(degrees, origin))
