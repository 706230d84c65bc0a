"""Guidance of a session towards its destination: where routes meet tracking."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint
from app.engine.navigation.guidance import OPTIONS as GUIDANCE
from app.engine.navigation.guidance import Guidance, guide
from app.engine.navigation.language import Speaker, language_of
from app.engine.navigation.model import Route
from app.engine.navigation.places import PlanPlace, parse_place
from app.errors import NoRouteError, OffNetworkError
from app.limits import limit
from app.services.routes import RouteService

BY_WALKS = "roomfix simulate; docs/simulation.md."

LOST = "The last frame was not located: the way goes on as soon as one is."


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionGuidanceOptions:
    """How long guidance holds for somebody who is not located, or is off the route."""

    off_route_frames: int = limit(
        3,
        "Frames in a row off the route after which a new one is made; one frame may be wrong.",
        chosen=BY_WALKS,
    )
    go_on_m: float = limit(
        4.0, "Longest way that somebody who is not located is told to go on.", chosen=BY_WALKS
    )
    turn_deg_s: float = limit(30.0, "Slowest that somebody turns.", chosen="By hand.")
    pace_m_s: float = limit(0.9, "Slowest that somebody walks.", chosen="By hand: a slow walker.")
    go_on_floor_s: float = limit(
        20.0,
        "Time for which guidance holds on the way to another floor, where little is seen.",
        chosen="By hand: a flight of stairs.",
    )


OPTIONS = SessionGuidanceOptions()


@dataclass(slots=True, kw_only=True)
class Way:
    """The route that a session follows; kept in memory only, since any frame can make it anew."""

    destination: str | None = None
    route: Route | None = None
    along_m: float = 0.0
    off_route: int = 0
    told: Guidance | None = None
    told_s: float = 0.0


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
        time_s: float = 0.0,
        position_sigma_m: float = 0.0,
    ) -> dict[str, Any] | None:
        """Return what to tell a walker at a point of a floor's plan, None without a destination or a plan.

        Somebody who is not located is told to go on as told before, and when that is done, how to be located.
        Plans the way when there is none yet, and again when the walker has left it. `time_s` is the frame's,
        `position_sigma_m` one sigma of the point.
        """
        if destination is not None and not located:
            known = way.destination == destination and way.told is not None
            go_on_m = _go_on_m(way, time_s) if known else None
            key = "go_on" if go_on_m is not None else "lost" if known else "unknown"
            said = Speaker(language_of(language), {}).say(key)
            return {
                "instruction": said,
                "arrived": False,
                "problem": "lost",
                "detail": LOST,
                "go_on_m": go_on_m,
            }
        if destination is None or floor is None or plan is None:
            return None
        planned = (
            way.route is None or way.destination != destination or way.off_route >= OPTIONS.off_route_frames
        )
        if planned:
            problem = self._plan(way, venue_id, destination, floor, plan)
            if problem is not None:
                return problem
        assert way.route is not None  # noqa: S101 - planned above
        spoken = language_of(language)
        told = guide(
            way.route,
            floor.id,
            plan.x,
            plan.y,
            plan.heading_deg,
            spoken,
            way.along_m,
            position_sigma_m=position_sigma_m,
        )
        way.told, way.told_s = told, time_s
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
        way.told = None
        try:
            way.route = self._routes.route(venue_id, start, destination, heading_deg=plan.heading_deg)
        except (NoRouteError, OffNetworkError) as error:
            return {"instruction": None, "arrived": False, "problem": error.code, "detail": str(error)}
        return None


def _go_on_m(way: Way, time_s: float) -> float | None:
    """Return how far somebody not located any more goes as told when they last were; None when that is done, or
    when nothing was told that could be gone on with."""
    told = way.told
    if told is None or told.off_route or told.arrived or told.distance_m is None:
        return None
    away_s = abs(time_s - way.told_s)
    if told.turn in ("up", "down") and told.bearing_deg is None:
        return told.distance_m if away_s <= OPTIONS.go_on_floor_s else None
    stretch_m = min(max(told.distance_m, GUIDANCE.arrow_ahead_m), OPTIONS.go_on_m)
    needed_s = abs(told.bearing_deg or 0.0) / OPTIONS.turn_deg_s + stretch_m / OPTIONS.pace_m_s
    return stretch_m if away_s <= needed_s else None
