"""GeoJSON geometries as NumPy and shapely, in plan metres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.model import Kind, LinkMode
from app.engine.floors.origin import Origin
from app.errors import InvalidInputError

Points = NDArray[np.float64]

MAX_COORDINATE_M = 1e6
MAX_VERTICES = 5_000
# Shorter links and smaller areas are no place for a person: most likely degrees taken for metres.
MIN_LINK_M, MIN_AREA_M2 = 0.01, 0.01
DEGREES_HINT = "coordinates are metres, unless origin says that they are longitude and latitude"
GEOMETRY_OF: dict[Kind, str] = {"landmark": "Point", "poi": "Point", "area": "Polygon", "link": "LineString"}


def read_point(geometry: object, kind: Kind, origin: Origin | None) -> Points:
    """Return the one position (2,) of a Point; raises `InvalidInputError`."""
    return np.asarray(_positions([_coordinates(geometry, GEOMETRY_OF[kind])], origin)[0])


def read_line(geometry: object, mode: LinkMode, origin: Origin | None) -> Points:
    """Return a link's positions (n, 2), n >= 2, without repetitions; raises `InvalidInputError`.

    A way between floors may stand on one spot; it may even be a Point.
    """
    if mode != "walk" and isinstance(geometry, Mapping) and geometry.get("type") == "Point":
        points = _positions([_coordinates(geometry, "Point")], origin)
    else:
        points = _positions(_coordinates(geometry, GEOMETRY_OF["link"]), origin)
        if len(points) < 2:
            raise InvalidInputError("a link's line has two positions or more.")
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if mode == "walk" and steps_m.sum() < MIN_LINK_M:
        raise InvalidInputError(f"its line is shorter than {MIN_LINK_M} m; {DEGREES_HINT}.")
    moved = points[np.concatenate([[True], steps_m > 1e-9])]
    return moved if len(moved) > 1 else np.repeat(moved, 2, axis=0)


def read_polygon(geometry: object, origin: Origin | None) -> shapely.Polygon:
    """Return a valid polygon; raises `InvalidInputError` for one that crosses itself or has no area."""
    rings = _coordinates(geometry, GEOMETRY_OF["area"])
    if not rings or not all(isinstance(ring, list) for ring in rings):
        raise InvalidInputError("a Polygon's coordinates are a list of rings of positions.")
    if len(rings) > MAX_VERTICES or sum(map(len, rings)) > MAX_VERTICES:
        raise InvalidInputError(f"it has more than {MAX_VERTICES:,} positions.")
    rows = [_positions(ring, origin) for ring in rings]
    if any(len(np.unique(ring, axis=0)) < 3 for ring in rows):
        raise InvalidInputError("each ring of a Polygon needs three different positions or more.")
    polygon = shapely.Polygon(rows[0], rows[1:])
    if not polygon.is_valid:
        raise InvalidInputError(_fault(polygon))
    if polygon.area < MIN_AREA_M2:
        raise InvalidInputError(f"its area is below {MIN_AREA_M2} m2; {DEGREES_HINT}.")
    return polygon


def _fault(polygon: shapely.Polygon) -> str:
    """Say why a polygon is not valid, and where."""
    what, _, where = str(shapely.is_valid_reason(polygon)).partition("[")
    at = f" at ({', '.join(where.rstrip(']').split())})" if where else ""
    if "intersection" in what.lower() or "crosses" in what.lower():
        return f"the area intersects itself{at}."
    return f"its polygon is not valid: {what.strip().lower()}{at}."


def _coordinates(geometry: object, wanted: str) -> Any:
    if not isinstance(geometry, Mapping):
        raise InvalidInputError(f"it has no geometry; it needs a {wanted}.")
    if geometry.get("type") != wanted:
        raise InvalidInputError(f"its geometry must be a {wanted}, not {short(geometry.get('type'))}.")
    coordinates = geometry.get("coordinates")
    if not isinstance(coordinates, list):
        raise InvalidInputError(f"its {wanted} has no list of coordinates.")
    return coordinates


def _positions(values: list[Any], origin: Origin | None) -> Points:
    """Return positions [[x, y], ...] as (n, 2) in plan metres; a third number is left out."""
    if len(values) > MAX_VERTICES:
        raise InvalidInputError(f"it has more than {MAX_VERTICES:,} positions.")
    for position in values:
        if not isinstance(position, list) or not 2 <= len(position) <= 4:
            raise InvalidInputError("a position is a list of two numbers, x and y.")
        for number in position:
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise InvalidInputError(f"a position holds {short(number)}, which is not a number.")
            if not abs(number) <= MAX_COORDINATE_M:
                raise InvalidInputError(
                    f"a position is not finite, or not within {MAX_COORDINATE_M:,.0f} m of the plan's origin."
                )
    points = np.array([position[:2] for position in values], dtype=np.float64).reshape(-1, 2)
    return points if origin is None or not len(points) else origin.plan_from_geodetic(points)


def short(value: object) -> str:
    """Return a value for a message, not longer than a few words."""
    text = repr(value) if isinstance(value, str | int | float | bool) else type(value).__name__
    return text if len(text) <= 60 else f"{text[:57]}..."
