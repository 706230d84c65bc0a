"""Whether somebody who was not seen for a while can be on another floor by now."""

from __future__ import annotations

import math

from app.engine.navigation.network import STAIRS_M_PER_LEVEL, Edge, Network, Node
from app.engine.navigation.places import PlanPlace

# Nobody gets on faster than this, waits and rides included in what a way between floors counts for.
PACE_M_S = 2.0
# What a place may be off by, and doors and stairs from where they are drawn.
SLACK_M = 1.0


def can_have_changed_floor(network: Network, place: PlanPlace, seconds: float) -> bool:
    """Return whether the walking network of a venue lets somebody who was at a place so many seconds ago be on
    another floor: the nearest stairs, lift or escalator is near enough to have been taken.

    Where a venue of several floors has no links between them, they may be anywhere.
    """
    if len(network.parts) < 2:
        return False
    reach_m = PACE_M_S * seconds + SLACK_M
    ways = _ways_between_floors(network)
    if not ways:
        return reach_m >= STAIRS_M_PER_LEVEL
    return any(
        math.dist((place.x, place.y), network.position(begin)) + edge.length_m <= reach_m
        for begin, edge in ways
        if begin[0] == place.floor
    )


def _ways_between_floors(network: Network) -> list[tuple[Node, Edge]]:
    """Return each way between floors with the node it begins at."""
    edges = network.graph.edges(data="edge")
    return [(begin, edge) for begin, _, edge in edges if edge.mode != "walk"]
