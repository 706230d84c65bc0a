"""Guidance of a session towards its destination: where routes meet tracking."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from app.errors import NoRouteError, OffNetworkError
from app.services.floor_plans import PlanPoint
from app.services.guidance import guide
from app.services.navigation.language import Speaker, language_of
from app.services.navigation.model import Route
from app.services.navigation.places import PlanPlace, parse_place
from app.services.navigation.service import RouteService
from app.storage.floors import Floor

# Somebody who is off the route on so many frames in a row gets a new one; one frame may be wrong.
OFF_ROUTE_FRAMES = 3
LOST = "The last frame was not located: the way goes on as soon as one is."


@dataclass(slots=True)
class Way:
    """The route that a session follows; kept in memory only, since any frame can make it anew."""

    destination: str | None = None
    route: Route | None = None
    along_m: float = 0.0
    off_route: int = 0


class SessionGuide:
    """Leads sessions to their destinations."""

    def __init__(self, routes: RouteService) -> None:
        self._routes = routes

    def check(self, venue_id: str, destination: str | None, language: str | None) -> None:
        """Check what a session asks for; raises `NotFoundError` and `InvalidInputError` as a route does."""
        language_of(language)
        if destination is not None:
            parse_place(destination, self._routes.network(venue_id), "destination")

    def guidance(
        self,
        way: Way,
        venue_id: str,
        destination: str | None,
        language: str | None,
        floor: Floor | None,
        plan: PlanPoint | None,
        located: bool = True,
    ) -> dict[str, Any] | None:
        """Return what to tell a walker at a point of a floor's plan, None without a destination or a plan.

        Somebody who is not located is told how to be. Plans the way when there is none yet, and again when the
        walker has left it.
        """
        if destination is not None and not located:
            said = Speaker(language_of(language), {}).say("lost")
            return {"instruction": said, "arrived": False, "problem": "lost", "detail": LOST}
        if destination is None or floor is None or plan is None:
            return None
        planned = way.route is None or way.destination != destination or way.off_route >= OFF_ROUTE_FRAMES
        if planned:
            problem = self._plan(way, venue_id, destination, floor, plan)
            if problem is not None:
                return problem
        assert way.route is not None  # noqa: S101 - planned above
        spoken = language_of(language)
        told = guide(way.route, floor.id, plan.x, plan.y, plan.heading_deg, spoken, way.along_m)
        way.off_route = way.off_route + 1 if told.off_route else 0
        if told.along_m is not None and not told.off_route:
            # Somebody who comes back from a dead end is past it, though they are where they were before.
            way.along_m = max(way.along_m, told.along_m)
        return {**asdict(told), "planned": planned, "problem": None}

    def _plan(
        self, way: Way, venue_id: str, destination: str, floor: Floor, plan: PlanPoint
    ) -> dict[str, Any] | None:
        """Plan the way from a point; return the guidance that there is none to give, if so."""
        start = PlanPlace(floor.id, plan.x, plan.y)
        way.destination, way.route, way.along_m, way.off_route = destination, None, 0.0, 0
        try:
            way.route = self._routes.route(venue_id, start, destination, heading_deg=plan.heading_deg)
        except (NoRouteError, OffNetworkError) as error:
            return {"instruction": None, "arrived": False, "problem": error.code, "detail": str(error)}
        return None
