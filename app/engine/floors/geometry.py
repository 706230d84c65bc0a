"""GeoJSON geometries as NumPy and shapely, in plan metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.model import Kind, LinkMode
from app.engine.floors.options import OPTIONS as FLOOR
from app.engine.floors.origin import Origin
from app.engine.floors.sentences import short
from app.errors import InvalidInputError
from app.limits import limit

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryOptions:
    """Which geometries a feature may have."""

    max_positions: int = limit(
        5_000,
        "Positions of one feature.",
        chosen="By hand: the outline of a building with all its pillars has some hundreds.",
    )
    min_link_m: float = limit(
        0.01,
        "Length of a walkable line.",
        chosen="By hand: nobody walks shorter ones; such lines come from degrees taken for metres.",
    )
    min_area_m2: float = limit(
        0.01,
        "Size of an area.",
        chosen="By hand: no person fits into smaller ones; such areas come from degrees taken for metres.",
    )


OPTIONS = GeometryOptions()
# Points of a line closer than this are the same point.
SAME_POINT_M = 1e-9
DEGREES_HINT = "coordinates are metres, unless origin says that they are longitude and latitude"
GEOMETRY_OF: dict[Kind, str] = {"landmark": "Point", "poi": "Point", "area": "Polygon", "link": "LineString"}


def read_point(geometry: object, kind: Kind, origin: Origin | None) -> Points:
    """Return the one position (2,) of a Point; raises `InvalidInputError`."""
    return np.asarray(_positions([_coordinates(geometry, GEOMETRY_OF[kind])], origin)[0])


def read_line(geometry: object, mode: LinkMode, origin: Origin | None) -> Points:
    """Return a link's positions (n, 2), n >= 2, without repetitions; raises `InvalidInputError`.

    A way between floors may be a Point, or a line of no length: then its position comes twice.
    """
    if mode != "walk" and isinstance(geometry, Mapping) and geometry.get("type") in ("Point", "MultiPoint"):
        points = _positions([_coordinates(geometry, "Point")], origin)
    else:
        points = _positions(_coordinates(geometry, GEOMETRY_OF["link"]), origin)
        if len(points) < 2:
            raise InvalidInputError("a link's line has two positions or more.")
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if mode == "walk" and steps_m.sum() < OPTIONS.min_link_m:
        raise InvalidInputError(f"its line is shorter than {OPTIONS.min_link_m} m; {DEGREES_HINT}.")
    moved = points[np.concatenate([[True], steps_m > SAME_POINT_M])]
    return moved if len(moved) > 1 else np.repeat(moved, 2, axis=0)


def read_polygon(geometry: object, origin: Origin | None) -> shapely.Polygon:
    """Return a valid polygon; raises `InvalidInputError` for one that crosses itself or has no area."""
    rings = _coordinates(geometry, GEOMETRY_OF["area"])
    if not rings or not all(isinstance(ring, list) for ring in rings):
        raise InvalidInputError("a Polygon's coordinates are a list of rings of positions.")
    if len(rings) > OPTIONS.max_positions or sum(map(len, rings)) > OPTIONS.max_positions:
        raise InvalidInputError(f"it has more than {OPTIONS.max_positions:,} positions.")
    rows = [_positions(ring, origin) for ring in rings]
    if any(len(np.unique(ring, axis=0)) < 3 for ring in rows):
        raise InvalidInputError("each ring of a Polygon needs three different positions or more.")
    polygon = shapely.Polygon(rows[0], rows[1:])
    if not polygon.is_valid:
        raise InvalidInputError(_fault(polygon))
    if polygon.area < OPTIONS.min_area_m2:
        raise InvalidInputError(f"its area is below {OPTIONS.min_area_m2} m2; {DEGREES_HINT}.")
    return polygon


def _fault(polygon: shapely.Polygon) -> str:
    """Say why a polygon is not valid, and where."""
    what, _, where = str(shapely.is_valid_reason(polygon)).partition("[")
    at = f" at ({', '.join(where.rstrip(']').split())})" if where else ""
    if "intersection" in what.lower() or "crosses" in what.lower():
        return f"the area intersects itself{at}."
    return f"its polygon is not valid: {what.strip().lower()}{at}."


def _coordinates(geometry: object, wanted: str) -> Any:
    """Return the coordinates of a geometry of type `wanted`, or of the only part of a Multi geometry of that type."""
    if not isinstance(geometry, Mapping):
        raise InvalidInputError(f"it has no geometry; it needs a {wanted}.")
    given, coordinates = geometry.get("type"), geometry.get("coordinates")
    if given == f"Multi{wanted}" and isinstance(coordinates, list) and coordinates:
        if len(coordinates) > 1:
            raise InvalidInputError(
                f"its {given} has {len(coordinates)} parts; make a feature of each, with an id of its own (in QGIS: "
                "Multipart to Singleparts)."
            )
        coordinates = coordinates[0]
    elif given != wanted:
        raise InvalidInputError(f"its geometry must be a {wanted}, not {short(given)}.")
    if not isinstance(coordinates, list):
        raise InvalidInputError(f"its {wanted} has no list of coordinates.")
    return coordinates


def _positions(values: list[Any], origin: Origin | None) -> Points:
    """Return positions [[x, y], ...] as (n, 2) in plan metres; a third and fourth number are ignored."""
    if len(values) > OPTIONS.max_positions:
        raise InvalidInputError(f"it has more than {OPTIONS.max_positions:,} positions.")
    for position in values:
        if not isinstance(position, list) or not 2 <= len(position) <= 4:
            raise InvalidInputError("a position is a list of two numbers, x and y.")
        for number in position:
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise InvalidInputError(f"a position holds {short(number)}, which is not a number.")
            if not abs(number) <= FLOOR.max_coordinate_m:
                raise InvalidInputError(
                    f"a position is not finite, or not within {FLOOR.max_coordinate_m:,.0f} m of the plan's origin; "
                    "coordinates of a map grid, such as UTM, must be moved to the plan first."
                )
    points = np.array([position[:2] for position in values], dtype=np.float64).reshape(-1, 2)
    return points if origin is None or not len(points) else origin.plan_from_geodetic(points)
