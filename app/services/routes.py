"""Routes of venues, on networks that are kept until a floor or its features change."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.floors.floor import Floor
from app.engine.navigation.model import Route
from app.engine.navigation.network import Network, build_network
from app.engine.navigation.places import Place, parse_place
from app.engine.navigation.search import Limits, find_way
from app.engine.navigation.steps import make_route
from app.limits import limit
from app.lru import LruCache
from app.services.floor_features import FeatureLibrary
from app.storage.db import Database
from app.storage.floors import list_floors
from app.storage.venues import get_venue


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkCacheOptions:
    """How many walking networks stay in memory."""

    venues: int = limit(
        16,
        "Venues whose walking network is kept in memory, those used last.",
        chosen="By hand: the network of a few floors is built anew in less than a tenth of a second.",
    )


OPTIONS = NetworkCacheOptions()
NO_LIMITS = Limits()


class RouteService:
    """Finds routes. Safe to share between threads."""

    def __init__(self, database: Database, features: FeatureLibrary) -> None:
        self._database = database
        self._features = features
        self._networks: LruCache[tuple[object, ...], Network] = LruCache(OPTIONS.venues)

    def network(self, venue_id: str) -> Network:
        """Return the walking network of a venue; raises `NotFoundError`."""
        with self._database.read() as connection:
            get_venue(connection, venue_id)
            floors = list_floors(connection, venue_id)
        key = (venue_id, *(_revision(floor) for floor in floors))
        return self._networks.get_or_make(
            key, lambda: build_network([(floor, self._features.index(floor)) for floor in floors])
        )

    def route(
        self,
        venue_id: str,
        start: str | Place,
        end: str | Place,
        limits: Limits = NO_LIMITS,
        heading_deg: float | None = None,
    ) -> Route:
        """Return the shortest route between two places of a venue; a text is what `parse_place` reads.

        Raises `NoRouteError` when no way joins them, `OffNetworkError` for a place too far from every link,
        `NotFoundError` and `InvalidInputError` for places that can't be meant.
        """
        network = self.network(venue_id)
        source = parse_place(start, network, "from") if isinstance(start, str) else start
        target = parse_place(end, network, "to") if isinstance(end, str) else end
        return make_route(network, source, target, find_way(network, source, target, limits), heading_deg)


def _revision(floor: Floor) -> tuple[object, ...]:
    placed = None if floor.plan_from_world is None else floor.plan_from_world.tobytes()
    return floor.id, floor.name, floor.level, floor.features_sha256, placed
