"""Walkable links of a level that has none, made from the shapes of its rooms and from its doors.

In each room the doors and landmarks are joined by a sparse graph: of the shortest ways between them (over the
visibility graph of the room's inner corners) a greedy spanner keeps those that shorten a walk notably. Source: the
greedy spanner and the visibility graph of computational geometry, textbook.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import shapely  # type: ignore[import-untyped]

from app.importers.plans.model import Door, Points, Room
from app.importers.plans.room_paths import paths_in_room
from app.limits import limit

Node = tuple[float, float]
DECIMALS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkwayOptions:
    """How doors and open borders join rooms."""

    door_reach_m: float = limit(
        0.6,
        "A door joins the two nearest rooms whose outlines are at most this far from its middle.",
        chosen="By hand: outlines end at the walls' faces, and an outer wall is half a metre thick.",
    )
    border_gap_m: float = limit(
        0.1,
        "Outlines of open rooms this close to each other are one border.",
        chosen="By hand: above the rounding of drawing tools, below the thickness of a wall.",
    )
    min_border_m: float = limit(
        0.7, "A shorter border between open rooms is not walked through.", chosen="By hand: a narrow door."
    )
    border_step_m: float = limit(
        6.0,
        "A longer border between open rooms is crossed at several places, this far apart.",
        chosen="By hand: a detour of 3 m at most, and few links in a wide hall.",
    )
    wall_m: float = limit(
        0.05, "Half of the thickness of a wall that is drawn as a line.", chosen="By hand: a thin inner wall."
    )
    min_room_m2: float = limit(
        0.3, "What walls leave of a room is not walked when it is smaller.", chosen="By hand: no person fits."
    )
    target_reach_m: float = limit(
        2.0,
        "A landmark outside all walkable rooms is joined to a room that is at most this far away.",
        chosen="By hand: a counter or machine that one stands in front of.",
    )


OPTIONS = WalkwayOptions()


@dataclass(frozen=True, slots=True)
class Space:
    """A part of a room that can be walked without a door."""

    polygon: shapely.Polygon
    is_open: bool


def walkways(
    rooms: Sequence[Room], doors: Sequence[Door], targets: Points, walls: Sequence[shapely.LineString] = ()
) -> list[Points]:
    """Return lines (n, 2) in plan metres that join `targets` (t, 2) through the rooms and doors.

    Lines end at targets or at each other; what leads to no target is left out.
    """
    spaces = _spaces(rooms, walls)
    ends: list[list[Node]] = [[] for _ in spaces]
    for point, members in _crossings(spaces, doors):
        for member in members:
            ends[member].append(point)
    wanted = [_node(point) for point in targets]
    _place_targets(wanted, spaces, ends)
    graph = nx.Graph()
    for space, points in zip(spaces, ends, strict=True):
        for a, b in paths_in_room(space.polygon, np.array(sorted(set(points))).reshape(-1, 2)):
            if a != b:
                graph.add_edge(a, b)
    _prune(graph, set(wanted))
    return list(_chains(graph, set(wanted)))


def _node(point: Sequence[float] | Points) -> Node:
    return round(float(point[0]), DECIMALS), round(float(point[1]), DECIMALS)


def _spaces(rooms: Sequence[Room], walls: Sequence[shapely.LineString]) -> list[Space]:
    """Return the walkable rooms less walls and what stands in them."""
    solid = [room.polygon for room in rooms if not room.is_walkable]
    solid += [wall.buffer(OPTIONS.wall_m, cap_style="flat") for wall in walls]
    tree = shapely.STRtree(solid)
    found = []
    for room in (room for room in rooms if room.is_walkable):
        near = tree.query(room.polygon, predicate="intersects")
        left = (
            room.polygon.difference(shapely.union_all([solid[k] for k in near]))
            if len(near)
            else room.polygon
        )
        for part in shapely.get_parts(left):
            if isinstance(part, shapely.Polygon) and part.area >= OPTIONS.min_room_m2:
                found.append(Space(part, room.is_open or room.mode is not None))
    return found


def _crossings(spaces: Sequence[Space], doors: Sequence[Door]) -> Iterator[tuple[Node, list[int]]]:
    """Yield each place where one goes from a space to another, with the spaces' indices."""
    tree = shapely.STRtree([space.polygon for space in spaces])
    joined: set[tuple[int, int]] = set()
    for door in doors:
        here = shapely.Point(door.x, door.y)
        near = [int(k) for k in tree.query(here, predicate="dwithin", distance=OPTIONS.door_reach_m)]
        near.sort(key=lambda k: (round(float(spaces[k].polygon.distance(here)), 3), spaces[k].polygon.area))
        yield _node((door.x, door.y)), near[:2]
        joined.add(_pair(near[:2]))
    polygons = [space.polygon for space in spaces]
    for a, space in enumerate(spaces):
        for found in tree.query(space.polygon, predicate="dwithin", distance=OPTIONS.border_gap_m):
            b = int(found)
            if a < b and space.is_open and spaces[b].is_open and (a, b) not in joined:
                for point in _border_points(polygons[a], polygons[b]):
                    yield point, [a, b]


def _pair(members: Sequence[int]) -> tuple[int, int]:
    return (min(members), max(members)) if len(members) == 2 else (-1, -1)


def _border_points(a: shapely.Polygon, b: shapely.Polygon) -> Iterator[Node]:
    """Yield points along the border that two open rooms share."""
    border = a.boundary.intersection(b.buffer(OPTIONS.border_gap_m))
    pieces = shapely.get_parts(
        shapely.line_merge(border) if border.geom_type == "MultiLineString" else border
    )
    for piece in pieces:
        if not isinstance(piece, shapely.LineString) or piece.length < OPTIONS.min_border_m:
            continue
        count = max(1, round(piece.length / OPTIONS.border_step_m))
        for k in range(count):
            yield _node(piece.interpolate((k + 0.5) / count, normalized=True).coords[0])


def _place_targets(targets: Sequence[Node], spaces: Sequence[Space], ends: list[list[Node]]) -> None:
    """Add each target to the smallest space that holds it, else to the nearest one within reach."""
    if not spaces:
        return
    tree = shapely.STRtree([space.polygon for space in spaces])
    for target in targets:
        here = shapely.Point(target)
        near = [int(k) for k in tree.query(here, predicate="dwithin", distance=OPTIONS.target_reach_m)]
        best = min(
            near,
            key=lambda k: (round(float(spaces[k].polygon.distance(here)), 3), spaces[k].polygon.area),
            default=None,
        )
        if best is not None:
            ends[best].append(target)


def _prune(graph: nx.Graph, targets: set[Node]) -> None:
    """Remove dead ends that lead to no target, and what is joined to none."""
    loose = [node for node in graph if graph.degree(node) <= 1 and node not in targets]
    while loose:
        node = loose.pop()
        if node not in graph or graph.degree(node) > 1:
            continue
        neighbours = list(graph[node])
        graph.remove_node(node)
        loose += [other for other in neighbours if graph.degree(other) <= 1 and other not in targets]
    for part in list(nx.connected_components(graph)):
        if not part & targets:
            graph.remove_nodes_from(part)


def _chains(graph: nx.Graph, targets: set[Node]) -> Iterator[Points]:
    """Yield the lines of a graph, each from one target or fork to the next."""
    stops = {node for node in graph if node in targets or graph.degree(node) != 2}
    for part in nx.connected_components(graph):
        if not part & stops:
            stops.add(min(part))
    walked: set[frozenset[Node]] = set()
    for stop in sorted(stops):
        for first in sorted(graph[stop]):
            if frozenset((stop, first)) in walked:
                continue
            line = [stop, first]
            while line[-1] not in stops:
                line.append(next(node for node in graph[line[-1]] if node != line[-2]))
            walked |= {frozenset(step) for step in pairwise(line)}
            if line[0] == line[-1] and len(line) > 3:
                yield np.array(line[: len(line) // 2 + 1])
                line = line[len(line) // 2 :]
            yield np.array(line)


def shared_rooms(rooms: Sequence[Room], door: Door) -> int:
    """Return how many walkable rooms lie at a door."""
    here = shapely.Point(door.x, door.y)
    return sum(room.is_walkable and room.polygon.distance(here) <= OPTIONS.door_reach_m for room in rooms)


def stacked_rooms(
    lower: Sequence[Room], upper: Sequence[Room], min_ratio: float
) -> Iterator[tuple[Room, Room]]:
    """Yield pairs of rooms of the same mode of which at least `min_ratio` of the smaller lies above the other."""
    for a in lower:
        for b in upper:
            if a.mode is None or a.mode != b.mode:
                continue
            overlap_m2 = float(a.polygon.intersection(b.polygon).area)
            if overlap_m2 >= min_ratio * min(a.polygon.area, b.polygon.area):
                yield a, b
