"""The walkable lines of one floor as a graph: lines that meet or cross share a node there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from app.engine.floors.model import FloorFeatures, Link
from app.engine.floors.options import OPTIONS as FLOOR
from app.errors import InvalidInputError
from app.limits import limit

Array = NDArray[np.float64]

# Pieces of lines shorter than this have no direction.
MIN_PIECE_M = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class NodingOptions:
    """How lines become a graph."""

    merge_m: float = limit(
        0.01,
        "Points this close are one node, and a point this close to a line is on it.",
        chosen="By hand: above the rounding of drawing tools, below everything that is drawn apart on purpose.",
    )
    grid_m: float = limit(
        1e-3,
        "Points in the same cell of a grid of this size are merged before distances between points are compared.",
        chosen="By hand: a tenth of `merge_m`; the number of pairs grows with the square of the points at one place.",
    )
    max_crossings: int = limit(
        100_000,
        "Times that the lines of a floor may meet or cross.",
        chosen="By hand: far above real plans, and the graph still takes only seconds to build.",
    )
    chunk_pieces: int = limit(
        256,
        "Straight pieces that are compared with all others at once.",
        chosen="By hand: it bounds memory before the number of crossings is checked.",
    )


OPTIONS = NodingOptions()


@dataclass(frozen=True, slots=True)
class Junction:
    """A point where a way between floors begins or ends; no line need end there.

    It joins the landmark of the id `landmark` if that is set, else the nearest landmark within `radius_m`, else the
    nearest line within `radius_m`.
    """

    x: float
    y: float
    landmark: str | None
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorGraph:
    """Nodes (n, 2) in plan metres, and edges (m, 2) as rows of nodes.

    Each edge is a straight piece of the link whose index is in `edge_links` (m,), or a spur: the short way between a
    landmark and the link beside it. `landmark_nodes` has the node of each landmark and POI, `junction_nodes` the node
    of each junction, None for a junction that meets nothing.
    """

    nodes: Array
    edges: NDArray[np.int64]
    edge_links: NDArray[np.int64]
    edge_is_spur: NDArray[np.bool_]
    landmark_nodes: dict[str, int]
    junction_nodes: list[int | None]


@dataclass(slots=True)
class _Cuts:
    """Points on segments: the rows of the segments, and the fractions of their lengths, 0 to 1."""

    segments: list[NDArray[np.int64]] = field(default_factory=list)
    fractions: list[Array] = field(default_factory=list)

    def add(self, segments: NDArray[np.int64], fractions: Array) -> None:
        self.segments.append(segments)
        self.fractions.append(np.clip(fractions, 0.0, 1.0))


def node_floor(features: FloorFeatures, junctions: list[Junction]) -> FloorGraph:
    """Return the graph of a floor's walk links; raises `InvalidInputError` for lines that cross too often."""
    marks = [*features.landmarks.values(), *features.pois.values()]
    mark_points = np.array([(mark.x, mark.y) for mark in marks]).reshape(-1, 2)
    mark_index = {mark.id: index for index, mark in enumerate(marks)}
    placed = [_placed(junction, mark_index, mark_points) for junction in junctions]
    anchors = np.vstack([mark_points, *(point[None] for point, _ in placed)])
    reach = np.array([FLOOR.touch_m] * len(marks) + [one.radius_m for one in junctions])
    lines = _joined_lines(features, mark_index, anchors)
    starts, ends, owners = _segments(lines)
    cuts = _Cuts()
    _cut_where_lines_meet(starts, ends, cuts)
    spurs = _cut_at_anchors(starts, ends, anchors, reach, cuts)
    met = {anchor for anchor, _, _ in spurs}
    joined = [
        on_mark or (one.landmark is None and len(marks) + index in met)
        for index, (one, (_, on_mark)) in enumerate(zip(junctions, placed, strict=True))
    ]
    return _assemble(starts, ends, owners, cuts, anchors, spurs, mark_index, joined)


def _placed(junction: Junction, mark_index: dict[str, int], marks: Array) -> tuple[Array, bool]:
    """Return the position (2,) of a junction, and whether that is a landmark's."""
    here = np.array([junction.x, junction.y])
    if junction.landmark is not None:
        index = mark_index.get(junction.landmark)
        return (here, False) if index is None else (marks[index], True)
    if len(marks):
        distances_m = np.linalg.norm(marks - here, axis=1)
        nearest = int(np.argmin(distances_m))
        if distances_m[nearest] <= junction.radius_m:
            return marks[nearest], True
    return here, False


def _joined_lines(
    features: FloorFeatures, mark_index: dict[str, int], anchors: Array
) -> list[tuple[int, Array]]:
    """Return the indices and lines of the walk links, each end moved onto the landmark or line that it touches."""
    lines = [(index, link.points.copy()) for index, link in enumerate(features.links) if link.mode == "walk"]
    tree = cKDTree(anchors) if len(anchors) else None
    loose: list[tuple[int, int]] = []
    for row, (index, points) in enumerate(lines):
        for position, name in _ends(features.links[index]):
            target = anchors[mark_index[name]] if name in mark_index else None
            if target is None and tree is not None:
                distance_m, nearest = tree.query(points[position])
                target = anchors[nearest] if distance_m <= FLOOR.touch_m else None
            if target is None:
                loose.append((row, position))
            else:
                points[position] = target
    if loose and len(lines) > 1:
        _join_to_lines(lines, loose)
    return lines


def _ends(link: Link) -> tuple[tuple[int, str | None], tuple[int, str | None]]:
    return (0, link.start), (-1, link.end)


def _join_to_lines(lines: list[tuple[int, Array]], loose: list[tuple[int, int]]) -> None:
    """Move each loose end onto the nearest other line that it touches."""
    tree = shapely.STRtree([shapely.LineString(points) for _, points in lines])
    for row, position in loose:
        here = shapely.Point(lines[row][1][position])
        # Twice the distance, since a line whose end was moved before may have come nearer.
        near = [int(k) for k in tree.query(here, predicate="dwithin", distance=2 * FLOOR.touch_m) if k != row]
        others = [shapely.LineString(lines[k][1]) for k in near]
        distances_m = [float(line.distance(here)) for line in others]
        if others and min(distances_m) <= FLOOR.touch_m:
            line = others[int(np.argmin(distances_m))]
            on_line = line.interpolate(line.project(here))
            lines[row][1][position] = on_line.x, on_line.y


def _segments(lines: list[tuple[int, Array]]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the straight pieces of the lines: starts (s, 2), ends (s, 2) and indices of their links (s,)."""
    none = np.empty((0, 2))
    starts = np.vstack([none, *(points[:-1] for _, points in lines)])
    ends = np.vstack([none, *(points[1:] for _, points in lines)])
    owners = np.repeat([index for index, _ in lines], [len(points) - 1 for _, points in lines])
    keep = np.linalg.norm(ends - starts, axis=1) > MIN_PIECE_M
    return starts[keep], ends[keep], owners.astype(np.int64)[keep]


def _cut_where_lines_meet(starts: Array, ends: Array, cuts: _Cuts) -> None:
    if not len(starts):
        return
    pieces = shapely.linestrings(np.stack([starts, ends], axis=1))
    tree = shapely.STRtree(pieces)
    total = 0
    for first in range(0, len(pieces), OPTIONS.chunk_pieces):
        rows, others = tree.query(
            pieces[first : first + OPTIONS.chunk_pieces], predicate="dwithin", distance=OPTIONS.merge_m
        )
        rows = rows + first
        a, b = rows[rows < others], others[rows < others]
        total += len(a)
        if total > OPTIONS.max_crossings + 4 * len(pieces):
            raise InvalidInputError(
                f"The links meet or cross more than {OPTIONS.max_crossings:,} times; draw fewer and simpler ones."
            )
        _cut_pairs(starts, ends, a, b, cuts)


def _cut_pairs(starts: Array, ends: Array, a: NDArray[np.int64], b: NDArray[np.int64], cuts: _Cuts) -> None:
    """Cut the segments of rows a and b (p,) where they cross, and where an end of one lies on the other."""
    along_a, along_b = ends[a] - starts[a], ends[b] - starts[b]
    between = starts[b] - starts[a]
    determinant = along_a[:, 0] * along_b[:, 1] - along_a[:, 1] * along_b[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (between[:, 0] * along_b[:, 1] - between[:, 1] * along_b[:, 0]) / determinant
        u = (between[:, 0] * along_a[:, 1] - between[:, 1] * along_a[:, 0]) / determinant
    crossing = (t >= 0) & (t <= 1) & (u >= 0) & (u <= 1)
    cuts.add(a[crossing], t[crossing])
    cuts.add(b[crossing], u[crossing])
    for own, other in ((a, b), (b, a)):
        for tips in (starts, ends):
            fractions, distances_m = _projected(starts[own], ends[own], tips[other])
            touching = distances_m <= OPTIONS.merge_m
            cuts.add(own[touching], fractions[touching])


def _projected(starts: Array, ends: Array, points: Array) -> tuple[Array, Array]:
    """Return, for each point (n, 2), the fraction along its segment of the nearest point, and the distance (n,)."""
    along = ends - starts
    squared = np.maximum((along**2).sum(axis=1), 1e-18)
    fractions = np.clip(((points - starts) * along).sum(axis=1) / squared, 0.0, 1.0)
    nearest = starts + fractions[:, None] * along
    return fractions, np.linalg.norm(points - nearest, axis=1)


def _cut_at_anchors(
    starts: Array, ends: Array, anchors: Array, reach: Array, cuts: _Cuts
) -> list[tuple[int, Array, int]]:
    """Cut the segment nearest to each anchor within its reach; return (anchor, point on segment, segment) of each."""
    if not len(starts) or not len(anchors):
        return []
    tree = shapely.STRtree(shapely.linestrings(np.stack([starts, ends], axis=1)))
    found, segments = tree.query_nearest(
        shapely.points(anchors), max_distance=float(reach.max()), all_matches=False
    )
    fractions, distances_m = _projected(starts[segments], ends[segments], anchors[found])
    near = distances_m <= reach[found]
    cuts.add(segments[near], fractions[near])
    points = starts[segments] + fractions[:, None] * (ends - starts)[segments]
    rows = np.flatnonzero(near)
    return [(int(found[row]), points[row], int(segments[row])) for row in rows]


def _assemble(
    starts: Array,
    ends: Array,
    owners: NDArray[np.int64],
    cuts: _Cuts,
    anchors: Array,
    spurs: list[tuple[int, Array, int]],
    mark_index: dict[str, int],
    joined: list[bool],
) -> FloorGraph:
    """Merge points that coincide into nodes, and join neighbours on a segment by edges."""
    count = np.arange(len(starts))
    segments = np.concatenate([count, count, *cuts.segments]).astype(np.int64)
    fractions = np.concatenate([np.zeros(len(starts)), np.ones(len(starts)), *cuts.fractions])
    order = np.lexsort([fractions, segments])
    segments, fractions = segments[order], fractions[order]
    on_segments = starts[segments] + fractions[:, None] * (ends - starts)[segments]
    spur_points = np.array([point for _, point, _ in spurs]).reshape(-1, 2)
    nodes, labels = merge_points(np.vstack([anchors, on_segments, spur_points]))
    first, last = len(anchors), len(anchors) + len(on_segments)
    along = labels[first:last]
    follows = segments[1:] == segments[:-1]
    pairs = np.column_stack([along[:-1], along[1:]])[follows]
    links = owners[segments[:-1]][follows]
    anchor_of_spur = np.array([anchor for anchor, _, _ in spurs], dtype=np.int64)
    spur_pairs = np.column_stack([labels[anchor_of_spur], labels[last:]]).reshape(-1, 2)
    spur_links = owners[np.array([segment for _, _, segment in spurs], dtype=np.int64)]
    edges = np.vstack([pairs, spur_pairs]).astype(np.int64)
    edge_links = np.concatenate([links, spur_links]).astype(np.int64)
    moved = edges[:, 0] != edges[:, 1]
    junction_labels = labels[len(mark_index) : first]
    return FloorGraph(
        nodes=nodes,
        edges=edges[moved],
        edge_links=edge_links[moved],
        edge_is_spur=(np.arange(len(edges)) >= len(pairs))[moved],
        landmark_nodes={mark: int(labels[index]) for mark, index in mark_index.items()},
        junction_nodes=[
            int(label) if meets else None for label, meets in zip(junction_labels, joined, strict=True)
        ],
    )


def merge_points(points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the different points (n, 2), merged where they are within `merge_m`, and for each given point its row."""
    if not len(points):
        return points, np.empty(0, dtype=np.int64)
    cells = np.round(points / OPTIONS.grid_m).astype(np.int64)
    _, kept, cell_of = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(points[kept]).query_pairs(OPTIONS.merge_m, output_type="ndarray")
    joined = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(kept),) * 2)
    count, of_kept = connected_components(joined, directed=False)
    labels = of_kept[cell_of.ravel()].astype(np.int64)
    firsts = np.full(count, len(points), dtype=np.int64)
    np.minimum.at(firsts, labels, np.arange(len(points)))
    return points[firsts], labels
