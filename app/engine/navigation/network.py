"""A venue's walking graph: the graphs of its floors, joined by stairs, lifts and escalators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.floor import Floor
from app.engine.floors.model import FloorFeatures, Landmark, Link, LinkMode
from app.engine.floors.options import OPTIONS as FLOOR
from app.engine.floors.places import PlaceIndex
from app.engine.floors.sentences import short
from app.engine.navigation.noding import FloorGraph, Junction, node_floor
from app.geometry.plan import PlanTransform
from app.limits import limit

Array = NDArray[np.float64]
# The id of a floor and a row of that floor's nodes; a route adds nodes with rows below zero.
Node = tuple[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkOptions:
    """How floors are joined, and the length that a way between them counts for when its link gives none."""

    arrival_m: float = limit(
        2.0,
        "A way between floors joins the nearest landmark or link within this distance of the point where it arrives.",
        chosen="By hand: that point is carried over through two plans, each some decimetres off.",
    )
    stairs_m_per_level: float = limit(
        10.0,
        "Length of a flight of stairs.",
        chosen="By hand: two flights of about 5 m for a storey of 3.5 m.",
    )
    escalator_m_per_level: float = limit(
        10.0, "Length of an escalator.", chosen="By hand: as long as stairs, since people stand on it."
    )
    lift_m: float = limit(
        12.0, "Length that waiting for a lift counts for.", chosen="By hand: a wait of 10 s."
    )
    lift_m_per_level: float = limit(
        3.0,
        "Length that the ride of a lift counts for.",
        chosen="By hand: a ride of 2 to 3 s for each level.",
    )
    max_unmet: int = limit(
        50,
        "Links that meet nothing on the other floor and are named in an answer.",
        chosen="By hand: one page.",
    )


OPTIONS = NetworkOptions()


@dataclass(frozen=True, slots=True)
class Edge:
    """A way from one node to the next. A way between floors has `line` (n, 2), its drawn line in plan metres of the
    floor `from_floor`, where it begins."""

    length_m: float
    mode: LinkMode
    accessible: bool
    line: Array | None = None
    from_floor: str | None = None


@dataclass(frozen=True, slots=True)
class FloorPart:
    """One floor of the network: `segments` are shapely lines, one for each edge of its graph."""

    floor: Floor
    places: PlaceIndex
    graph: FloorGraph
    segments: NDArray[Any]
    tree: shapely.STRtree


@dataclass(frozen=True, slots=True)
class Network:
    """`graph` is a directed multigraph of `Node`s whose edges hold an `Edge` under "edge".

    `unmet` are links that lead to a floor where they meet nothing.
    """

    graph: nx.MultiDiGraph
    parts: dict[str, FloorPart]
    unmet: tuple[tuple[str, Link], ...]

    def position(self, node: Node) -> Array:
        """Return where a node is, plan metres (2,)."""
        return np.asarray(self.parts[node[0]].graph.nodes[node[1]])

    def places_named(self, text: str) -> list[tuple[str, Landmark]]:
        """Return all landmarks and POIs of that id, each with the id of its floor."""
        return [
            (floor_id, mark)
            for floor_id, part in self.parts.items()
            for group in (part.places.features.landmarks, part.places.features.pois)
            if (mark := group.get(text)) is not None
        ]


def build_network(floors: Sequence[tuple[Floor, PlaceIndex]]) -> Network:
    """Return the network of a venue's floors. A link to a floor that is not there counts as unmet."""
    by_id = {floor.id: floor for floor, _ in floors}
    junctions: dict[str, list[Junction]] = {floor_id: [] for floor_id in by_id}
    ways = []
    for floor, places in floors:
        for link in places.features.links:
            if link.to_floor is None:
                continue
            target = by_id.get(link.to_floor)
            begins = _add(junctions[floor.id], link.points[0], link.start, FLOOR.touch_m)
            arrives = None
            if target is not None:
                end = _carried(link.points[-1:], floor, target)[0]
                arrives = _add(junctions[target.id], end, link.end, OPTIONS.arrival_m)
            ways.append((floor, link, target, begins, arrives))
    parts = {floor.id: _part(floor, places, junctions[floor.id]) for floor, places in floors}
    graph = nx.MultiDiGraph()
    for part in parts.values():
        _add_floor(graph, part)
    unmet = []
    for floor, link, target, begins, arrives in ways:
        start = parts[floor.id].graph.junction_nodes[begins]
        end = None
        if target is not None and arrives is not None:
            end = parts[target.id].graph.junction_nodes[arrives]
        if start is None or end is None or target is None:
            unmet.append((floor.id, link))
        else:
            _add_way(graph, link, (floor.id, start), (target.id, end), floor, target)
    return Network(graph, parts, tuple(unmet))


def _add(junctions: list[Junction], point: Array, landmark: str | None, radius_m: float) -> int:
    junctions.append(Junction(float(point[0]), float(point[1]), landmark, radius_m))
    return len(junctions) - 1


def _carried(points: Array, floor: Floor, target: Floor) -> Array:
    """Return plan points (n, 2) of one floor on the plan of another, through the world; unchanged when one of them has
    no `plan_from_world`."""
    if floor.plan_from_world is None or target.plan_from_world is None:
        return points
    flat = np.column_stack([points, np.zeros(len(points))])
    in_world = PlanTransform(floor.plan_from_world).apply_inverse(flat)
    return np.asarray(PlanTransform(target.plan_from_world).apply(in_world)[:, :2])


def _part(floor: Floor, places: PlaceIndex, junctions: list[Junction]) -> FloorPart:
    graph = node_floor(places.features, junctions)
    lines = shapely.linestrings(graph.nodes[graph.edges]) if len(graph.edges) else np.empty(0, dtype=object)
    return FloorPart(floor, places, graph, lines, shapely.STRtree(lines))


def _add_floor(graph: nx.MultiDiGraph, part: FloorPart) -> None:
    floor_id, nodes = part.floor.id, part.graph.nodes
    links = part.places.features.links
    graph.add_nodes_from((floor_id, row) for row in range(len(nodes)))
    for row, ((a, b), index) in enumerate(zip(part.graph.edges, part.graph.edge_links, strict=True)):
        link = links[index]
        edge = Edge(float(np.linalg.norm(nodes[a] - nodes[b])), "walk", link.accessible)
        graph.add_edge((floor_id, int(a)), (floor_id, int(b)), edge=edge)
        if not link.one_way or part.graph.edge_is_spur[row]:
            graph.add_edge((floor_id, int(b)), (floor_id, int(a)), edge=edge)


def _add_way(graph: nx.MultiDiGraph, link: Link, start: Node, end: Node, floor: Floor, target: Floor) -> None:
    length_m = way_length_m(link, abs(floor.level - target.level))
    edge = Edge(length_m, link.mode, link.accessible, link.points, floor.id)
    graph.add_edge(start, end, edge=edge)
    if not link.one_way:
        graph.add_edge(end, start, edge=edge)


def way_length_m(link: Link, levels: int) -> float:
    """Return the length in metres that a way between floors counts for: its `length_m`, else a length by its mode and
    `levels`; stairs and escalators count for their drawn line if that is longer."""
    if link.length_m is not None:
        return link.length_m
    drawn_m = float(np.linalg.norm(np.diff(link.points, axis=0), axis=1).sum())
    levels = max(levels, 1)
    if link.mode == "lift":
        return OPTIONS.lift_m + OPTIONS.lift_m_per_level * levels
    per_level_m = OPTIONS.stairs_m_per_level if link.mode == "stairs" else OPTIONS.escalator_m_per_level
    return max(per_level_m * levels, drawn_m)


def unmet_links(network: Network) -> list[str]:
    """Return a sentence for each link that meets nothing on the floor it leads to, `max_unmet` at most."""
    return [
        f"Link {short(link.id)} of floor {short(floor_id)} meets nothing on floor {short(link.to_floor)} yet."
        for floor_id, link in network.unmet[: OPTIONS.max_unmet]
    ]


def check_walkable(features: FloorFeatures) -> None:
    """Raise `InvalidInputError` when a floor's links are too tangled to become a network."""
    node_floor(features, [])
