"""Whether a walker who was not located for some time can be on another floor."""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.engine.navigation.network import OPTIONS as NETWORK
from app.engine.navigation.network import Edge, Network, Node
from app.engine.navigation.places import PlanPlace
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorChangeOptions:
    """How fast a walker can reach another floor."""

    pace_m_s: float = limit(
        2.0,
        "Speed that no walker exceeds; a wait or ride is part of the length that a way between floors counts for.",
        chosen="By hand: people walk at 1.2 to 1.5 m/s.",
    )
    slack_m: float = limit(
        1.0,
        "Added to the distance that a walker can have gone.",
        chosen="By hand: for the error of the last position, and of where stairs are drawn.",
    )


OPTIONS = FloorChangeOptions()


def can_have_changed_floor(network: Network, place: PlanPlace, seconds: float) -> bool:
    """Return whether a walker who was at a place `seconds` ago can be on another floor by now.

    The walker can when some stairs, lift or escalator of the network is near enough to have been taken since. In a
    venue of several floors without any link between them, the time for one level of stairs is enough.
    """
    if len(network.parts) < 2:
        return False
    reach_m = OPTIONS.pace_m_s * seconds + OPTIONS.slack_m
    ways = _ways_between_floors(network)
    if not ways:
        return reach_m >= NETWORK.stairs_m_per_level
    return any(
        math.dist((place.x, place.y), network.position(begin)) + edge.length_m <= reach_m
        for begin, edge in ways
        if begin[0] == place.floor
    )


def _ways_between_floors(network: Network) -> list[tuple[Node, Edge]]:
    """Return each way between floors with the node where it begins."""
    edges = network.graph.edges(data="edge")
    return [(begin, edge) for begin, _, edge in edges if edge.mode != "walk"]
