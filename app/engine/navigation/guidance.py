"""Guidance: what to say next to somebody who follows a route, from where they are now."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from app.engine.navigation.language import DEFAULT_LANGUAGE, Speaker
from app.engine.navigation.model import Route, RoutePoint, Step, Turn
from app.engine.navigation.steps import angle_between_deg, turn_of

OFF_ROUTE_M = 3.0
ARRIVED_M = 1.75
# A step this near is done now; the way to one farther off is told first.
NOW_M = 2.0
# Somebody who looks aside still walks ahead.
WRONG_WAY_DEG = 60.0
LOOK_AHEAD_M = 1.5
# Of several stretches of the way as near as this to each other, the one not walked yet is meant.
SAME_M = 0.5
# Stretches that follow each other within this belong to one visit; what is further on is come by again later.
VISIT_M = 2.0
# An arrow points at the way so far ahead: through a door, not through the wall beside it.
ARROW_AHEAD_M = 1.2
# Around a corner that point may be where the walker stands: then one further on, at least so far from them. Who is so
# near to where the way turns back has been there.
ARROW_CLEAR_M, ARROW_STEP_M = 0.6, 0.2
# Where the way so far before and after a point differs so much in direction, it turns back there.
BACK_M, BACK_DEG = 1.0, 135.0


@dataclass(frozen=True, slots=True)
class Guidance:
    """What to do next. `turn` and `landmark` are those of the next step, `distance_m` leads to it; all distances
    are along the route. Off the route, distances are from the route's nearest point, None on another floor.
    `bearing_deg` is for an arrow: how far to the left of where the walker looks the way goes on; None when it is not
    known where they look, on stairs, or when nothing of the way is on their floor."""

    instruction: str
    turn: Turn
    distance_m: float | None
    remaining_m: float | None
    off_route: bool
    arrived: bool
    landmark: str | None
    along_m: float | None
    bearing_deg: float | None = None


@dataclass(frozen=True, slots=True)
class _Nearest:
    """The point of the route next to the walker."""

    row: int
    along_m: float
    away_m: float


def guide(
    route: Route,
    floor: str,
    x: float,
    y: float,
    heading_deg: float | None = None,
    language: str = DEFAULT_LANGUAGE,
    progress_m: float = 0.0,
) -> Guidance:
    """Return what to tell a walker at plan position (x, y) of a floor, in metres.

    With `heading_deg`, counter-clockwise from plan x, a walker who faces elsewhere is told to turn first.
    `progress_m` is how far along the route they were before: where the way comes by twice, the rest counts.
    """
    speaker = Speaker(language, route.floor_names)
    nearest = _nearest(route, floor, x, y, progress_m)
    if nearest is None:
        return Guidance(speaker.say("off_route"), "u_turn", None, None, True, False, None, None)
    nearest = _after_turning_back(route, nearest)
    remaining_m = route.distance_m - nearest.along_m
    off_route = nearest.away_m > _tolerance_m(route, nearest)
    goal = route.points[-1]
    at_goal = floor == goal.floor and math.hypot(goal.x - x, goal.y - y) <= ARRIVED_M
    arrived = not off_route and at_goal and remaining_m <= 2 * ARRIVED_M
    current, following = _steps_at(route, nearest.along_m, arrived)
    ahead_m = max(following.along_m - nearest.along_m, 0.0)
    turn = following.turn
    if off_route:
        instruction = speaker.say("off_route")
    elif current.to_floor is not None:
        instruction, turn = speaker.maneuver(current), current.turn
    elif ahead_m <= NOW_M or arrived:
        instruction = speaker.maneuver(following)
    else:
        facing = None if heading_deg is None else _facing(route, nearest, heading_deg)
        instruction, turn = _way_to(speaker, current, following, ahead_m, facing)
    mark = following.at or following.towards
    landmark = None if mark is None else mark.id
    # On stairs the plan says nothing of the way: they are seen.
    unknown = heading_deg is None or current.to_floor is not None
    bearing_deg = None if unknown else _bearing_deg(route, nearest, floor, x, y, heading_deg or 0.0)
    return Guidance(
        instruction, turn, ahead_m, remaining_m, off_route, arrived, landmark, nearest.along_m, bearing_deg
    )


def _way_to(
    speaker: Speaker, current: Step, following: Step, ahead_m: float, facing: Turn | None
) -> tuple[str, Turn]:
    """Return the sentences for the way to the next step, and the turn that comes first."""
    goal = following if following.turn == "arrive" else None
    walk = speaker.walk(current, ahead_m, goal)
    if facing is not None:
        return f"{speaker.say(facing)} {walk}", facing
    if goal is not None:
        return walk, following.turn
    return f"{walk} {speaker.maneuver(following)}", following.turn


def _nearest(route: Route, floor: str, x: float, y: float, progress_m: float) -> _Nearest | None:
    """Return the nearest point of the route on this floor; of those about as near the first after `progress_m`."""
    found = [_on_piece(route, row, x, y) for row in _rows_on(route, floor)]
    if not found:
        return None
    least_m = min(one.away_m for one in found)
    near = [one for one in found if one.away_m <= least_m + SAME_M]
    ahead = [one for one in near if one.along_m >= progress_m - SAME_M] or near
    first_m = min(one.along_m for one in ahead)
    visit = [one for one in ahead if one.along_m <= first_m + VISIT_M]
    return min(visit, key=lambda one: (round(one.away_m / SAME_M), one.along_m))


def _rows_on(route: Route, floor: str) -> list[int]:
    """Return the rows of the points on a floor."""
    return [row for row, point in enumerate(route.points) if point.floor == floor]


def _on_piece(route: Route, row: int, x: float, y: float) -> _Nearest:
    """Return the nearest point of the piece from a point to the next on the same floor, or of the point alone."""
    a = route.points[row]
    b = route.points[row + 1] if row + 1 < len(route.points) else a
    if b.floor != a.floor:
        b = a
    along_x, along_y = b.x - a.x, b.y - a.y
    squared = along_x**2 + along_y**2
    share = 0.0 if squared == 0 else ((x - a.x) * along_x + (y - a.y) * along_y) / squared
    share = min(max(share, 0.0), 1.0)
    away_m = math.hypot(a.x + share * along_x - x, a.y + share * along_y - y)
    return _Nearest(row, a.along_m + share * (b.along_m - a.along_m), away_m)


def _tolerance_m(route: Route, nearest: _Nearest) -> float:
    """Return how far from the way is still on it: on stairs, as far as they are drawn."""
    modes = route.modes[max(nearest.row - 1, 0) : nearest.row + 1]
    if all(mode == "walk" for mode in modes):
        return OFF_ROUTE_M
    return OFF_ROUTE_M + max(_run_m(route, row) for row in (nearest.row - 1, nearest.row))


def _run_m(route: Route, row: int) -> float:
    """Return how long the way between floors around a piece is drawn, 0 for a walk."""
    if not 0 <= row < len(route.modes) or route.modes[row] == "walk":
        return 0.0
    first = last = row
    while first > 0 and route.modes[first - 1] == route.modes[row]:
        first -= 1
    while last + 1 < len(route.modes) and route.modes[last + 1] == route.modes[row]:
        last += 1
    points = route.points[first : last + 2]
    return sum(_apart_m(a, b) for a, b in pairwise(points) if a.floor == b.floor)


def _apart_m(a: RoutePoint, b: RoutePoint) -> float:
    return math.hypot(b.x - a.x, b.y - a.y)


def _steps_at(route: Route, along_m: float, arrived: bool) -> tuple[Step, Step]:
    """Return the step that is being followed, and the next one."""
    if arrived:
        return route.steps[-1], route.steps[-1]
    done = [index for index, step in enumerate(route.steps) if step.along_m <= along_m + 1e-6]
    index = min(done[-1] if done else 0, max(len(route.steps) - 2, 0))
    return route.steps[index], route.steps[min(index + 1, len(route.steps) - 1)]


def _facing(route: Route, nearest: _Nearest, heading_deg: float) -> Turn | None:
    """Return the turn towards the way ahead, None when the walker looks there already."""
    target = next(
        (point for point in route.points if point.along_m >= nearest.along_m + LOOK_AHEAD_M),
        route.points[-1],
    )
    here = _on_way(route, nearest)
    if target.floor != here.floor or _apart_m(here, target) < 1e-6:
        return None
    way_deg = math.degrees(math.atan2(target.y - here.y, target.x - here.x))
    angle_deg = angle_between_deg(heading_deg, way_deg)
    return turn_of(angle_deg) if abs(angle_deg) > WRONG_WAY_DEG else None


def _bearing_deg(
    route: Route, nearest: _Nearest, floor: str, x: float, y: float, heading_deg: float
) -> float | None:
    """Return how far to the left of a heading the way goes on, seen from (x, y); None where it ends."""
    target = _on_way(route, nearest)
    wanted_m = target.along_m + ARROW_AHEAD_M
    for row in range(nearest.row + 1, len(route.points)):
        end = route.points[row]
        if end.floor != floor:
            break
        while wanted_m <= end.along_m:
            target = _on_way(route, _Nearest(row - 1, wanted_m, 0.0))
            if math.hypot(target.x - x, target.y - y) >= ARROW_CLEAR_M:
                return angle_between_deg(heading_deg, math.degrees(math.atan2(target.y - y, target.x - x)))
            wanted_m += ARROW_STEP_M
        target = end
        if _turns_back(route, row):
            break
    if math.hypot(target.x - x, target.y - y) < 0.05:
        return None
    return angle_between_deg(heading_deg, math.degrees(math.atan2(target.y - y, target.x - x)))


def _after_turning_back(route: Route, nearest: _Nearest) -> _Nearest:
    """Return the place where the way turns back if that is next and near: to go on, not to and fro."""
    row = nearest.row + 1
    if row >= len(route.points) or not _turns_back(route, row):
        return nearest
    along_m = route.points[row].along_m
    return _Nearest(row, along_m, nearest.away_m) if along_m - nearest.along_m < ARROW_CLEAR_M else nearest


def _turns_back(route: Route, row: int) -> bool:
    """Return whether the way turns back at a point, as on a stub that leads to a landmark."""
    here, points = route.points[row], route.points
    before = next((p for p in reversed(points[:row]) if p.along_m <= here.along_m - BACK_M), points[0])
    after = next((p for p in points[row + 1 :] if p.along_m >= here.along_m + BACK_M), points[-1])
    if (
        not before.floor == here.floor == after.floor
        or min(_apart_m(before, here), _apart_m(here, after)) == 0
    ):
        return False
    came_deg = math.degrees(math.atan2(here.y - before.y, here.x - before.x))
    goes_deg = math.degrees(math.atan2(after.y - here.y, after.x - here.x))
    return abs(angle_between_deg(came_deg, goes_deg)) > BACK_DEG


def _on_way(route: Route, nearest: _Nearest) -> RoutePoint:
    a = route.points[nearest.row]
    b = route.points[min(nearest.row + 1, len(route.points) - 1)]
    length_m = b.along_m - a.along_m
    share = 0.0 if length_m <= 0 or b.floor != a.floor else (nearest.along_m - a.along_m) / length_m
    return RoutePoint(a.floor, a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), nearest.along_m)
