"""Where a person can stand on each floor, and ways that keep clear of walls and furniture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import dijkstra

from bench.venue.decor import furniture_of
from bench.venue.layout import (
    BUILDING_M,
    DOORS,
    FLOOR_HEIGHT_M,
    ROOMS,
    STAIR_RISERS,
    STAIR_START_Y_M,
    STAIR_TREAD_M,
    WALL_THICKNESS_M,
    Door,
    room_at,
    room_by_id,
)
from bench.venue.openings import shared_wall

Floats = NDArray[np.float64]

# The camera and the arms that hold it.
CLEARANCE_M = 0.25
CELL_M = 0.1
# Distance beyond a door at which a person is out of the room.
OUTSIDE_M = 1.0
# A thing above this height stops nobody.
HEAD_ROOM_M = 1.9


@lru_cache(maxsize=4)
def free_space(floor: int) -> shapely.Geometry:
    """Return the part of a floor not taken by walls, closed doors and furniture, world x, y in metres."""
    rooms = [r for r in ROOMS if r.floor == floor or r.id == "stair"]
    open_parts = [shapely.box(*r.interior) for r in rooms if r.id != "stair"] + [_stair_area(floor)]
    for door in DOORS:
        if door.floor == floor and not door.closed:
            side, _, line = shared_wall(door)
            a, b, half = (
                door.at_m - door.width_m / 2,
                door.at_m + door.width_m / 2,
                WALL_THICKNESS_M / 2 + 0.01,
            )
            open_parts.append(
                shapely.box(a, line - half, b, line + half)
                if side in "NS"
                else shapely.box(line - half, a, line + half, b)
            )
    return shapely.union_all(open_parts).difference(obstacles(floor))


def _stair_area(floor: int) -> shapely.Polygon:
    """Return the part of the stair one can stand on: below the first step, or the upper landing."""
    x0, y0, x1, y1 = room_by_id("stair").interior
    if floor == 0:
        return shapely.box(x0, y0, x1, STAIR_START_Y_M)
    return shapely.box(x0, STAIR_START_Y_M + (STAIR_RISERS - 1) * STAIR_TREAD_M, x1, y1)


@lru_cache(maxsize=4)
def obstacles(floor: int) -> shapely.Geometry:
    """Return the footprints of a floor's furniture."""
    footprints = [
        shapely.Polygon(item.corners_xy())
        for room in ROOMS
        if room.floor == floor and room.id != "stair"
        for item in furniture_of(room)
        if item.is_obstacle and item.base_m - room.base_m < HEAD_ROOM_M
    ]
    return shapely.union_all(footprints)


def clearance_m(points_xy: Floats, floor: int) -> Floats:
    """Return how far points (n, 2) are from the nearest wall or furniture; negative when inside of it."""
    space, points = free_space(floor), shapely.points(points_xy)
    distance = shapely.distance(points, space.boundary)
    return np.asarray(np.where(shapely.contains(space, points), distance, -distance))


def sees(start_xy: Floats, end_xy: Floats, floor: int) -> bool:
    """Return whether a straight line on the floor meets no wall or furniture."""
    return bool(shapely.contains(free_space(floor), shapely.linestrings([start_xy, end_xy])))


def ground_z_m(x_m: float, y_m: float, floor: int) -> float:
    """Return the world z underfoot; on the stair it rises with y, else it is the floor's."""
    x0, _, x1, _ = room_by_id("stair").bounds
    top = STAIR_START_Y_M + (STAIR_RISERS - 1) * STAIR_TREAD_M
    if x0 < x_m < x1 and STAIR_START_Y_M < y_m < top:
        return FLOOR_HEIGHT_M * (y_m - STAIR_START_Y_M) / (top - STAIR_START_Y_M)
    return floor * FLOOR_HEIGHT_M


@dataclass(frozen=True, slots=True)
class Grid:
    """A floor's cells: `clearance_m` (h, w) of each cell's middle and the `graph` of steps between
    neighbours."""

    clearance_m: Floats
    graph: sparse.csr_matrix

    def cell(self, point_xy: tuple[float, float]) -> int:
        """Return the number of the walkable cell nearest to a point."""
        rows, columns = np.nonzero(self.clearance_m > CLEARANCE_M)
        gap = np.hypot((columns + 0.5) * CELL_M - point_xy[0], (rows + 0.5) * CELL_M - point_xy[1])
        best = int(np.argmin(gap))
        return int(rows[best] * self.clearance_m.shape[1] + columns[best])


@lru_cache(maxsize=4)
def grid_of(floor: int) -> Grid:
    """Return a floor's grid. Steps cost more near obstacles, so that ways keep to the middle."""
    width, height = (round(side / CELL_M) for side in BUILDING_M)
    y, x = np.mgrid[0:height, 0:width]
    centres = (np.column_stack([x.ravel(), y.ravel()]) + 0.5) * CELL_M
    space = free_space(floor)
    shapely.prepare(space)
    inside = shapely.contains_xy(space, centres).reshape(height, width)
    clearance = np.asarray(ndimage.distance_transform_edt(inside)) * CELL_M - CELL_M / 2
    return Grid(clearance, _graph(clearance))


def _graph(clearance: Floats) -> sparse.csr_matrix:
    height, width = clearance.shape
    number = np.arange(height * width).reshape(height, width)
    cost = np.where(clearance > CLEARANCE_M, 1 + 0.5 / np.maximum(clearance, 0.05) ** 2, np.inf)
    rows, columns, weights = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, height - dy), slice(max(0, -dx), width - max(0, dx)))
        there = (slice(dy, height), slice(max(0, dx), width - max(0, -dx)))
        step = 0.5 * (cost[here] + cost[there]) * np.hypot(dx, dy)
        ok = np.isfinite(step)
        rows.append(number[here][ok])
        columns.append(number[there][ok])
        weights.append(step[ok])
    edges = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_matrix(edges, shape=(height * width, height * width))


def way(start_xy: tuple[float, float], end_xy: tuple[float, float], floor: int) -> Floats:
    """Return a walkable way (n, 2) between two points as the middles of its cells; raises ValueError if none
    is."""
    grid = grid_of(floor)
    start, end = grid.cell(start_xy), grid.cell(end_xy)
    _, previous = dijkstra(grid.graph, directed=False, indices=np.array([start]), return_predecessors=True)
    cells = [end]
    while cells[-1] != start:
        cells.append(int(previous[0, cells[-1]]))
        if cells[-1] < 0:
            raise ValueError(f"no way from {start_xy} to {end_xy} on floor {floor}")
    rows, columns = np.divmod(np.array(cells[::-1]), grid.clearance_m.shape[1])
    return np.asarray((np.column_stack([columns, rows]) + 0.5) * CELL_M)


def way_out(start_xy: tuple[float, float], floor: int) -> Floats | None:
    """Return the way (n, 2) from a point through the nearest open door of its room, None where there is none."""
    room = room_at(*start_xy, floor)
    doors = [
        door
        for door in DOORS
        if room is not None and door.floor == floor and room.id in (door.a, door.b) and not door.closed
    ]
    if room is None or not doors:
        return None
    ends = [_beyond(door, room.id) for door in doors]
    nearest = min(ends, key=lambda end: float(np.hypot(end[0] - start_xy[0], end[1] - start_xy[1])))
    return way(start_xy, nearest, floor)


def _beyond(door: Door, room_id: str) -> tuple[float, float]:
    """Return a point outside a room in front of one of its doors."""
    side_a, side_b, line_m = shared_wall(door)
    side = side_a if room_id == door.a else side_b
    away_m = OUTSIDE_M if side in "NE" else -OUTSIDE_M
    return (door.at_m, line_m + away_m) if side in "NS" else (line_m + away_m, door.at_m)
