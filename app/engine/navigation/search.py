"""The shortest way through the network that a traveller may take."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.model import LinkMode
from app.engine.floors.sentences import listed, short
from app.engine.navigation.model import RoutePoint
from app.engine.navigation.network import Edge, FloorPart, Network, Node
from app.engine.navigation.places import NamedPlace, Place
from app.errors import NoRouteError, NotFoundError, OffNetworkError
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchOptions:
    """How places join the network, and what is drawn of ways between floors."""

    reach_m: float = limit(
        10.0,
        "A place that is on no link is led to the nearest link within this distance.",
        chosen="By hand: the far corner of a large room is about this far from the line through its door.",
    )
    min_drawn_m: float = limit(
        0.5,
        "A way between floors whose line is shorter than this is shown as a point.",
        chosen="By hand: shorter lines are lifts, or stairs that were not drawn.",
    )


OPTIONS = SearchOptions()


@dataclass(frozen=True, slots=True)
class Limits:
    """What a traveller can't or doesn't want to use."""

    avoid: frozenset[LinkMode] = frozenset()
    accessible_only: bool = False

    def allow(self, edge: Edge) -> bool:
        """Return whether an edge may be used."""
        return edge.mode not in self.avoid and (edge.accessible or not self.accessible_only)

    def words(self) -> str:
        """Return the limits as the end of a sentence, empty when there are none."""
        parts = [f" without {' and '.join(sorted(self.avoid))}"] if self.avoid else []
        if self.accessible_only:
            parts.append(" by accessible links only")
        return "".join(parts)


@dataclass(frozen=True, slots=True)
class Way:
    """A found way: its points, and how each but the first is reached."""

    points: tuple[RoutePoint, ...]
    modes: tuple[LinkMode, ...]


def find_way(network: Network, start: Place, end: Place, limits: Limits) -> Way:
    """Return the shortest way from one place to the other.

    Raises `NoRouteError` when no way joins them, whose message names what can be reached, and `OffNetworkError` when a
    place is too far from every link. Source: Dijkstra's algorithm.
    """
    search = _Search(network, limits)
    source, target = search.attach(start, leaving=True), search.attach(end, leaving=False)
    search.join_on_one_segment()
    try:
        _, nodes = nx.single_source_dijkstra(search.graph, source, target, weight=search.weight)
    except nx.NetworkXNoPath:
        raise NoRouteError(search.why_not(start, end, source, target)) from None
    return search.way(nodes)


@dataclass(frozen=True, slots=True)
class _Attachment:
    """Where a place meets an edge of a floor's graph: at `node`, on edge `row`, at `fraction` of its length."""

    floor: str
    row: int
    fraction: float
    node: Node


class _Search:
    """One search: the network with the start and end of this route added."""

    def __init__(self, network: Network, limits: Limits) -> None:
        self._network = network
        self._limits = limits
        self.graph: nx.MultiDiGraph = network.graph
        self._own: dict[Node, Array] = {}
        self._attached: list[_Attachment] = []

    def weight(self, _: Node, __: Node, edges: dict[int, dict[str, Edge]]) -> float | None:
        """Return the length of the shortest edge that may be used between two nodes, None for none."""
        return min(
            (data["edge"].length_m for data in edges.values() if self._limits.allow(data["edge"])),
            default=None,
        )

    def attach(self, place: Place, leaving: bool) -> Node:
        """Return the node of a place; a place that is not on the network is joined to its nearest link."""
        part = self._network.parts.get(place.floor)
        if part is None:
            raise NotFoundError(f"There is no floor {short(place.floor)} any more.")
        x, y = (place.landmark.x, place.landmark.y) if isinstance(place, NamedPlace) else (place.x, place.y)
        if isinstance(place, NamedPlace):
            row = part.graph.landmark_nodes.get(place.landmark.id)
            if row is not None and self._network.graph.degree((place.floor, row)):
                return (place.floor, row)
        here = np.array([x, y])
        edge_row, fraction = self._nearest_edge(part, here)
        if not self._own:
            self.graph = self.graph.copy()
        return self._add(part, here, edge_row, fraction, leaving)

    def _nearest_edge(self, part: FloorPart, here: Array) -> tuple[int, float]:
        """Return the edge nearest to a point, one in the same area if there is one, and the fraction of its length
        where it is nearest."""
        links = part.places.features.links
        allowed = np.array(
            [self._limits.allow(Edge(0.0, "walk", link.accessible)) for link in links], dtype=bool
        )
        rows = np.flatnonzero(allowed[part.graph.edge_links]) if len(links) else np.empty(0, dtype=np.int64)
        point = shapely.Point(here)
        where = f"({here[0]:.2f}, {here[1]:.2f}) on floor {short(part.floor.id)}"
        if not len(rows):
            raise NoRouteError(f"Floor {short(part.floor.id)} has no link to walk on{self._limits.words()}.")
        distances_m = shapely.distance(part.segments[rows], point)
        if distances_m.min() > OPTIONS.reach_m:
            raise OffNetworkError(
                f"No link that may be walked is within {OPTIONS.reach_m:.0f} m of {where}; the nearest is "
                f"{distances_m.min():.1f} m away."
            )
        near = rows[distances_m <= OPTIONS.reach_m]
        pieces = part.segments[near]
        area = part.places.area(float(here[0]), float(here[1]))
        if area is not None:
            inside = shapely.intersection(pieces, area.polygon)
            if not shapely.is_empty(inside).all():
                pieces = inside
        best = int(np.argmin(np.where(shapely.is_empty(pieces), np.inf, shapely.distance(pieces, point))))
        nearest = shapely.get_point(shapely.shortest_line(pieces[best], point), 0)
        along = shapely.line_locate_point(part.segments[near[best]], nearest, normalized=True)
        return int(near[best]), float(along)

    def _add(self, part: FloorPart, here: Array, row: int, fraction: float, leaving: bool) -> Node:
        """Add a node for a place, one for the point where it meets an edge, and the edges between them."""
        floor_id = part.floor.id
        ends = part.graph.nodes[part.graph.edges[row]]
        on_edge = ends[0] + fraction * (ends[1] - ends[0])
        node, meeting = (floor_id, -1 - len(self._own)), (floor_id, -2 - len(self._own))
        self._own |= {node: here, meeting: on_edge}
        self._both(node, meeting, float(np.linalg.norm(here - on_edge)), True)
        length_m = float(np.linalg.norm(ends[1] - ends[0]))
        first, second = ((floor_id, int(k)) for k in part.graph.edges[row])
        one_way = self._is_one_way(part, row)
        accessible = part.places.features.links[part.graph.edge_links[row]].accessible
        for other, metres, forward in (
            (first, fraction * length_m, not leaving),
            (second, (1 - fraction) * length_m, leaving),
        ):
            if forward or not one_way:
                self._both(meeting, other, metres, accessible)
        self._attached.append(_Attachment(floor_id, row, fraction, meeting))
        return node

    def _is_one_way(self, part: FloorPart, row: int) -> bool:
        return (
            part.places.features.links[part.graph.edge_links[row]].one_way
            and not part.graph.edge_is_spur[row]
        )

    def _both(self, a: Node, b: Node, length_m: float, accessible: bool) -> None:
        edge = Edge(length_m, "walk", accessible)
        self.graph.add_edge(a, b, edge=edge)
        self.graph.add_edge(b, a, edge=edge)

    def join_on_one_segment(self) -> None:
        """Join start and end directly where both meet the same edge."""
        if len(self._attached) < 2:
            return
        start, end = self._attached
        if (start.floor, start.row) != (end.floor, end.row):
            return
        part = self._network.parts[start.floor]
        if end.fraction < start.fraction and self._is_one_way(part, start.row):
            return
        link = part.places.features.links[part.graph.edge_links[start.row]]
        ends = part.graph.nodes[part.graph.edges[start.row]]
        length_m = abs(end.fraction - start.fraction) * float(np.linalg.norm(ends[1] - ends[0]))
        self.graph.add_edge(start.node, end.node, edge=Edge(length_m, "walk", link.accessible))

    def way(self, nodes: list[Node]) -> Way:
        """Return the way through these nodes, with the drawn lines of ways between floors."""
        points = [self._point(nodes[0], 0.0)]
        modes: list[LinkMode] = []
        for a, b in pairwise(nodes):
            edges = [data["edge"] for data in self.graph[a][b].values()]
            edge: Edge = min(filter(self._limits.allow, edges), key=lambda one: one.length_m)
            along_m = points[-1].along_m
            for point, fraction in self._drawn(edge, a):
                points.append(
                    RoutePoint(a[0], float(point[0]), float(point[1]), along_m + fraction * edge.length_m)
                )
                modes.append(edge.mode)
            points.append(self._point(b, along_m + edge.length_m))
            modes.append(edge.mode)
        return Way(tuple(points), tuple(modes))

    def _drawn(self, edge: Edge, start: Node) -> list[tuple[Array, float]]:
        """Return the points of the line of a way between floors but the first, each with its fraction of the length."""
        if edge.line is None or start[0] != edge.from_floor:
            return []
        steps_m = np.linalg.norm(np.diff(edge.line, axis=0), axis=1)
        if steps_m.sum() < OPTIONS.min_drawn_m:
            return []
        fractions: list[float] = (np.cumsum(steps_m) / steps_m.sum()).tolist()
        return list(zip(edge.line[1:], fractions, strict=True))

    def _point(self, node: Node, along_m: float) -> RoutePoint:
        x, y = self._own[node] if node in self._own else self._network.position(node)
        return RoutePoint(node[0], float(x), float(y), along_m)

    def why_not(self, start: Place, end: Place, source: Node, target: Node) -> str:
        """Return a sentence that says which parts of the venue no way joins."""
        reached = set(nx.single_source_dijkstra_path_length(self.graph, source, weight=self.weight))
        floors = [
            floor_id for floor_id in self._network.parts if any(node[0] == floor_id for node in reached)
        ]
        words = self._limits.words()
        sentence = f"No way leads from {_words(start)} to {_words(end)}{words}"
        if end.floor in floors:
            sentence += f": they lie in parts of floor {short(end.floor)} that no link joins."
        else:
            what = "floor" if len(floors) == 1 else "floors"
            sentence += f": from the start only {what} {listed(floors)} can be reached."
        if words and nx.has_path(self.graph, source, target):
            return f"{sentence} Without these conditions there is one."
        if self._network.unmet:
            unmet = [f"{floor_id}:{link.id}" for floor_id, link in self._network.unmet]
            sentence += f" Links that meet nothing on the floor they lead to: {listed(unmet)}."
        return sentence


def _words(place: Place) -> str:
    if isinstance(place, NamedPlace):
        return f"{short(place.landmark.id)} on floor {short(place.floor)}"
    return f"({place.x:.2f}, {place.y:.2f}) on floor {short(place.floor)}"
