"""Counts which areas and landmarks of a venue its links connect."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import networkx as nx  # type: ignore[import-untyped]
import numpy as np

from app.engine.navigation.network import Network


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorSurvey:
    """The numbers of features of a floor; `joined_areas` counts the areas that a link enters."""

    id: str
    name: str
    areas: int
    landmarks: int
    links: int
    joined_areas: int


@dataclass(frozen=True, slots=True)
class Survey:
    """The counts of a venue. `parts` are the numbers of landmarks in each connected part of the network, largest first.

    `routed_pairs` of all `pairs` of areas have a route between them; `unmet` counts the links between floors that meet
    nothing where they lead.
    """

    floors: tuple[FloorSurvey, ...]
    parts: tuple[int, ...]
    pairs: int
    routed_pairs: int
    unmet: int

    @property
    def landmark_pairs(self) -> tuple[int, int]:
        """The number of pairs of landmarks with a route between them, and the number of all pairs."""
        return sum(map(_pairs, self.parts)), _pairs(sum(self.parts))


def _pairs(count: int) -> int:
    return count * (count - 1) // 2


def survey(network: Network) -> Survey:
    """Count what is connected; one-way links count as if they could be walked in both directions."""
    part_of = {
        node: part
        for part, nodes in enumerate(nx.weakly_connected_components(network.graph))
        for node in nodes
    }
    floors, parts_of_areas = [], []
    landmarks: Counter[int] = Counter()
    for floor_id, one in network.parts.items():
        features = one.places.features
        for landmark_id in features.landmarks:
            landmarks[part_of[floor_id, one.graph.landmark_nodes[landmark_id]]] += 1
        reached = []
        for area in features.areas:
            rows = one.tree.query(area.polygon, predicate="intersects")
            reached.append({part_of[floor_id, int(one.graph.edges[row, 0])] for row in rows})
        parts_of_areas += reached
        joined = sum(map(bool, reached))
        floors.append(
            FloorSurvey(
                id=floor_id,
                name=one.floor.name,
                areas=len(features.areas),
                landmarks=len(features.landmarks),
                links=len(features.links),
                joined_areas=joined,
            )
        )
    count = len(parts_of_areas)
    routed = sum(
        bool(parts_of_areas[a] & parts_of_areas[b]) for a, b in zip(*np.triu_indices(count, 1), strict=True)
    )
    parts = tuple(sorted(landmarks.values(), reverse=True))
    return Survey(tuple(floors), parts, _pairs(count), routed, len(network.unmet))
