"""Paths within one room: the shortest ways between its doors and landmarks, as few of them as serve all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from app.importers.plans.model import Points
from app.limits import limit

Node = tuple[float, float]
DECIMALS = 4
# Segments may leave a room by this much, the rounding of coordinates.
SLACK_M = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomPathOptions:
    """How paths run through a room."""

    clearances_m: tuple[float, ...] = limit(
        (0.4, 0.2, 0.08),
        "Distances that paths keep from walls; the first that leaves the room in one piece is used.",
        chosen="By hand: half a person's width with a bag, then less for narrow passages.",
    )
    corner_tolerance_m: float = limit(
        0.05,
        "An outline is simplified by this before its corners are taken.",
        chosen="By hand: a door frame.",
    )
    min_corner_deg: float = limit(
        8.0,
        "Corners that turn less are no corners.",
        chosen="By hand: a curved wall keeps a few of its points.",
    )
    max_corners: int = limit(
        300,
        "Corners of a room that paths may turn at, the sharpest.",
        chosen="By hand: a hall with 70 pillars.",
    )
    stretch_ratio: float = limit(
        1.15,
        "A path between two ends is added when the way over the present ones is longer by this ratio.",
        chosen="By hand: nobody notices a detour of a step in seven, and rooms keep few links.",
    )
    neighbours: int = limit(
        24,
        "Nearest ends of a room that an end is compared with.",
        chosen="By hand: all of them in most rooms; the time grows with the square of the number of ends.",
    )


OPTIONS = RoomPathOptions()


def paths_in_room(polygon: shapely.Polygon, ends: Points) -> Iterator[tuple[Node, Node]]:
    """Yield the straight pieces that join the ends (n, 2) of a room with each other, inside the room.

    An end on or outside the outline is joined to the nearest point that keeps clear of the walls.
    """
    if len(ends) < 2:
        return
    inner = _inner(polygon)
    nearest = [shapely.get_point(shapely.shortest_line(inner, shapely.Point(end)), 0) for end in ends]
    entries = np.round([point.coords[0] for point in nearest], DECIMALS)
    for end, entry in zip(ends, entries, strict=True):
        yield _node(end), _node(entry)
    starts = np.unique(entries, axis=0)
    nodes = np.vstack([starts, _corners(inner)])
    lengths_m, before = dijkstra(
        _visible(inner, nodes), directed=False, indices=range(len(starts)), return_predecessors=True
    )
    for path in _spanner(lengths_m, before, len(starts)):
        for a, b in pairwise(path):
            yield _node(nodes[a]), _node(nodes[b])


def _node(point: Sequence[float] | Points) -> Node:
    return round(float(point[0]), DECIMALS), round(float(point[1]), DECIMALS)


def _inner(polygon: shapely.Polygon) -> shapely.Polygon:
    """Return the room without a margin along its walls."""
    for clearance_m in OPTIONS.clearances_m:
        inner = polygon.buffer(-clearance_m, join_style="mitre")
        if isinstance(inner, shapely.Polygon) and not inner.is_empty:
            simple = inner.simplify(OPTIONS.corner_tolerance_m)
            return simple if isinstance(simple, shapely.Polygon) and simple.is_valid else inner
    return polygon


def _corners(polygon: shapely.Polygon) -> Points:
    """Return the corners (n, 2) that a shortest path can turn at: those that point into the room."""
    found, turns = [np.empty((0, 2))], [np.empty(0)]
    outline = shapely.orient_polygons(polygon)
    for ring in (outline.exterior, *outline.interiors):
        points = shapely.get_coordinates(ring)[:-1]
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        turn = np.arctan2(cross, (before * after).sum(axis=1))
        is_corner = turn < -np.radians(OPTIONS.min_corner_deg)
        found.append(points[is_corner])
        turns.append(turn[is_corner])
    sharpest = np.argsort(np.concatenate(turns), kind="stable")[: OPTIONS.max_corners]
    return np.asarray(np.round(np.vstack(found)[np.sort(sharpest)], DECIMALS))


def _visible(polygon: shapely.Polygon, nodes: Points) -> csr_array:
    """Return the lengths (n, n) of the straight segments between nodes that stay inside; other pairs are empty."""
    a, b = np.triu_indices(len(nodes), 1)
    segments = shapely.linestrings(np.stack([nodes[a], nodes[b]], axis=1))
    room = polygon.buffer(SLACK_M, join_style="mitre")
    shapely.prepare(room)
    seen = shapely.covers(room, segments)
    # Nodes at one place are joined too; zero would mean that there is no segment.
    lengths_m = np.maximum(np.linalg.norm(nodes[a] - nodes[b], axis=1), 1e-9)
    return csr_array((lengths_m[seen], (a[seen], b[seen])), shape=(len(nodes), len(nodes)))


def _spanner(lengths_m: Points, before: NDArray[np.int32], starts: int) -> Iterator[list[int]]:
    """Yield shortest paths between starts, as rows of nodes, that keep every detour below the stretch ratio.

    `lengths_m` and `before` (starts, n) are the lengths of the shortest ways and each node's predecessor.
    """
    graph = nx.Graph()
    graph.add_nodes_from(range(starts))
    for a, b in _pairs(lengths_m[:, :starts]):
        most_m = OPTIONS.stretch_ratio * lengths_m[a, b]
        if nx.has_path(graph, a, b) and nx.dijkstra_path_length(graph, a, b) <= most_m:
            continue
        path = [b]
        while path[-1] != a:
            path.append(int(before[a, path[-1]]))
        for near, far in pairwise(reversed(path)):
            graph.add_edge(near, far, weight=float(lengths_m[a, far] - lengths_m[a, near]))
        yield path


def _pairs(lengths_m: Points) -> list[tuple[int, int]]:
    """Return pairs of starts, nearest first: each with its neighbours, and the pairs that keep all connected."""
    finite = np.where(np.isfinite(lengths_m), lengths_m, 0.0)
    tree = minimum_spanning_tree(csr_array(finite)).tocoo()
    pairs = {(min(a, b), max(a, b)) for a, b in zip(tree.row.tolist(), tree.col.tolist(), strict=True)}
    for a, row in enumerate(np.argsort(lengths_m, axis=1)[:, : OPTIONS.neighbours + 1].tolist()):
        pairs |= {(min(a, b), max(a, b)) for b in row if a != b and np.isfinite(lengths_m[a, b])}
    return sorted(pairs, key=lambda pair: (float(lengths_m[pair]), pair))
