"""Guidance along a route: the next step for a walker, by where they are and where they face."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from app.engine.navigation.language import DEFAULT_LANGUAGE, Speaker
from app.engine.navigation.model import Route, RoutePoint, Step, Turn
from app.engine.navigation.steps import angle_between_deg, turn_of
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidanceOptions:
    """When a walker is off the route or has arrived, and where the arrow points."""

    off_route_m: float = limit(
        3.0,
        "A walker farther than this from the route has left it.",
        chosen="By hand: half the width of a hall, and far above the error of a position.",
    )
    arrived_m: float = limit(
        1.75,
        "A walker this close to the destination has arrived.",
        chosen="By hand, on walks of `roomfix simulate` (docs/simulation.md), which counts an arrival within 3 m.",
    )
    sure_sigma_m: float = limit(
        0.125,
        "Position sigma up to which a walker within `arrived_m` has arrived; beyond it one must be closer.",
        chosen="By hand: above the sigmas of places by a map; 1.75 m and two of it are 2 m.",
    )
    arrived_sigmas: float = limit(
        2.0,
        "A walker must be closer by this many of the sigmas beyond `sure_sigma_m` to have arrived.",
        chosen="By hand: the walker is within 2 m then in all but some 2 %. With 1, three of 30 walks of "
        "`roomfix simulate --no-map`, seed 1, ended 2.1 to 2.7 m before their destination.",
    )
    least_arrived_m: float = limit(
        0.6,
        "A walker this close to the destination has arrived, however uncertain the place.",
        chosen="By hand, on walks of `roomfix simulate --no-map` (docs/simulation.md).",
    )
    now_m: float = limit(
        2.0,
        "A step this close is said alone; for a step farther ahead the way to it is said first.",
        chosen="By hand: two or three strides.",
    )
    wrong_way_deg: float = limit(
        60.0,
        "A walker who faces farther than this away from the way ahead is told to turn first.",
        chosen="By hand: somebody who looks aside still walks ahead.",
    )
    look_ahead_m: float = limit(
        1.5,
        "The way ahead is the direction to the first point of the route at least this far on.",
        chosen="By hand: closer points give a direction that changes with every stride.",
    )
    same_m: float = limit(
        0.5,
        "Pieces of the route whose distances from the walker differ by less than this are equally near.",
        chosen="By hand: a few times the error of a position.",
    )
    visit_m: float = limit(
        2.0,
        "Equally near pieces this close together along the route belong to one visit of the place; the first visit "
        "that is not over counts.",
        chosen="By hand, on walks of `roomfix simulate` (docs/simulation.md).",
    )
    arrow_ahead_m: float = limit(
        1.2,
        "The arrow points at the route this far ahead.",
        chosen="By hand, on walks of `roomfix simulate` (docs/simulation.md): farther ahead it points at the wall "
        "beside a door.",
    )
    arrow_clear_m: float = limit(
        0.6,
        "The point of the arrow is at least this far from the walker, and a point where the route turns back counts as "
        "reached within this distance.",
        chosen="By hand, on walks of `roomfix simulate` (docs/simulation.md).",
    )
    arrow_step_m: float = limit(
        0.2,
        "Steps along the route in which a point far enough from the walker is searched for.",
        chosen="By hand: a third of `arrow_clear_m`.",
    )
    arrow_min_m: float = limit(
        0.05,
        "There is no arrow when the route ends closer to the walker than this.",
        chosen="By hand: within the error of a position a direction means nothing.",
    )
    back_m: float = limit(
        1.0,
        "Whether the route turns back at a point is judged by its points this far before and after.",
        chosen="By hand, on walks of `roomfix simulate` (docs/simulation.md).",
    )
    back_deg: float = limit(
        135.0,
        "The route turns back where its direction changes by more than this.",
        chosen="By hand: between a sharp turn and a full one.",
    )


OPTIONS = GuidanceOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Guidance:
    """What a walker does next.

    `turn` and `landmark` belong to the next step, and `distance_m` is the distance to it. All distances are along the
    route, for a walker off the route from the nearest point of it; they are None on a floor that the route doesn't use.
    `bearing_deg` is for an arrow on the phone: the direction of the way ahead, counter-clockwise from the direction
    that the walker faces. It is None when that is unknown, on stairs, and when no route is on the walker's floor.
    """

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
    """A point of the route: between the points of `row` and row + 1, `along_m` from the start; `away_m` is its distance
    from the walker."""

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
    position_sigma_m: float = 0.0,
) -> Guidance:
    """Return the guidance for a walker at plan position (x, y) of a floor, in metres, one sigma of which is given.

    `heading_deg` is the direction that the walker faces, counter-clockwise from plan x; one who faces another way than
    the route goes is told to turn first. `progress_m` is the walker's distance along the route so far; it decides where
    the route passes the same place twice.
    """
    speaker = Speaker(language, route.floor_names)
    nearest = _nearest(route, floor, x, y, progress_m)
    if nearest is None:
        return _on_another_floor(speaker)
    nearest = _after_turning_back(route, nearest)
    remaining_m = route.distance_m - nearest.along_m
    off_route = nearest.away_m > _tolerance_m(route, nearest)
    # Near the destination in space, but not along the route, is the far side of a wall or loop.
    near_end = remaining_m <= 2 * OPTIONS.arrived_m
    arrived = not off_route and near_end and _is_at_destination(route, floor, x, y, position_sigma_m)
    current, following = _steps_at(route, nearest.along_m, arrived)
    ahead_m = max(following.along_m - nearest.along_m, 0.0)
    turn = following.turn
    if off_route:
        instruction = speaker.say("off_route")
    elif current.to_floor is not None:
        instruction, turn = speaker.maneuver(current), current.turn
    elif ahead_m <= OPTIONS.now_m or arrived:
        instruction = speaker.maneuver(following)
    else:
        facing = None if heading_deg is None else _facing(route, nearest, heading_deg)
        instruction, turn = _way_to(speaker, current, following, ahead_m, facing)
    mark = following.at or following.towards
    landmark = None if mark is None else mark.id
    # On stairs there is no arrow: the walker sees the way, and the plan doesn't show it.
    unknown = heading_deg is None or current.to_floor is not None
    bearing_deg = None if unknown else _bearing_deg(route, nearest, floor, x, y, heading_deg or 0.0)
    return Guidance(
        instruction=instruction,
        turn=turn,
        distance_m=ahead_m,
        remaining_m=remaining_m,
        off_route=off_route,
        arrived=arrived,
        landmark=landmark,
        along_m=nearest.along_m,
        bearing_deg=bearing_deg,
    )


def _on_another_floor(speaker: Speaker) -> Guidance:
    """Return the guidance for a walker on a floor that the route doesn't use."""
    return Guidance(
        instruction=speaker.say("off_route"),
        turn="u_turn",
        distance_m=None,
        remaining_m=None,
        off_route=True,
        arrived=False,
        landmark=None,
        along_m=None,
    )


def _is_at_destination(route: Route, floor: str, x: float, y: float, sigma_m: float) -> bool:
    end = route.points[-1]
    within_m = OPTIONS.arrived_m - OPTIONS.arrived_sigmas * max(sigma_m - OPTIONS.sure_sigma_m, 0.0)
    return floor == end.floor and math.hypot(end.x - x, end.y - y) <= max(within_m, OPTIONS.least_arrived_m)


def _way_to(
    speaker: Speaker, current: Step, following: Step, ahead_m: float, facing: Turn | None
) -> tuple[str, Turn]:
    """Return the sentences for the way to the next step, and the first turn in them."""
    goal = following if following.turn == "arrive" else None
    walk = speaker.walk(current, ahead_m, goal)
    if facing is not None:
        return f"{speaker.say(facing)} {walk}", facing
    if goal is not None:
        return walk, following.turn
    return f"{walk} {speaker.maneuver(following)}", following.turn


def _nearest(route: Route, floor: str, x: float, y: float, progress_m: float) -> _Nearest | None:
    """Return the point of the route nearest to (x, y) on a floor; of equally near ones the first after `progress_m`."""
    found = [_on_piece(route, row, x, y) for row in _rows_on(route, floor)]
    if not found:
        return None
    least_m = min(one.away_m for one in found)
    near = [one for one in found if one.away_m <= least_m + OPTIONS.same_m]
    ahead = [one for one in near if one.along_m >= progress_m - OPTIONS.same_m] or near
    first_m = min(one.along_m for one in ahead)
    visit = [one for one in ahead if one.along_m <= first_m + OPTIONS.visit_m]
    return min(visit, key=lambda one: (round(one.away_m / OPTIONS.same_m), one.along_m))


def _rows_on(route: Route, floor: str) -> list[int]:
    """Return the rows of the route's points on a floor."""
    return [row for row, point in enumerate(route.points) if point.floor == floor]


def _on_piece(route: Route, row: int, x: float, y: float) -> _Nearest:
    """Return the point nearest to (x, y) on the piece from `row` to the next row; the point of `row` itself when the
    next one is on another floor."""
    a = route.points[row]
    b = route.points[row + 1] if row + 1 < len(route.points) else a
    if b.floor != a.floor:
        b = a
    along_x, along_y = b.x - a.x, b.y - a.y
    squared = along_x**2 + along_y**2
    fraction = 0.0 if squared == 0 else ((x - a.x) * along_x + (y - a.y) * along_y) / squared
    fraction = min(max(fraction, 0.0), 1.0)
    away_m = math.hypot(a.x + fraction * along_x - x, a.y + fraction * along_y - y)
    return _Nearest(row, a.along_m + fraction * (b.along_m - a.along_m), away_m)


def _tolerance_m(route: Route, nearest: _Nearest) -> float:
    """Return the distance from the route up to which a walker is on it; around stairs their drawn length is added,
    since nobody is located on them."""
    modes = route.modes[max(nearest.row - 1, 0) : nearest.row + 1]
    if all(mode == "walk" for mode in modes):
        return OPTIONS.off_route_m
    return OPTIONS.off_route_m + max(_run_m(route, row) for row in (nearest.row - 1, nearest.row))


def _run_m(route: Route, row: int) -> float:
    """Return the drawn length of the way between floors that a piece belongs to, 0 for a walk."""
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
    """Return the step that the walker is following, and the next one."""
    if arrived:
        return route.steps[-1], route.steps[-1]
    done = [index for index, step in enumerate(route.steps) if step.along_m <= along_m + 1e-6]
    index = min(done[-1] if done else 0, max(len(route.steps) - 2, 0))
    return route.steps[index], route.steps[min(index + 1, len(route.steps) - 1)]


def _facing(route: Route, nearest: _Nearest, heading_deg: float) -> Turn | None:
    """Return the turn towards the way ahead, None when the walker faces it already."""
    target = next(
        (point for point in route.points if point.along_m >= nearest.along_m + OPTIONS.look_ahead_m),
        route.points[-1],
    )
    here = _on_way(route, nearest)
    if target.floor != here.floor or _apart_m(here, target) < 1e-6:
        return None
    way_deg = math.degrees(math.atan2(target.y - here.y, target.x - here.x))
    angle_deg = angle_between_deg(heading_deg, way_deg)
    return turn_of(angle_deg) if abs(angle_deg) > OPTIONS.wrong_way_deg else None


def _bearing_deg(
    route: Route, nearest: _Nearest, floor: str, x: float, y: float, heading_deg: float
) -> float | None:
    """Return the direction from (x, y) to the route ahead, in degrees counter-clockwise from a heading; None at the end
    of the route."""
    target = _on_way(route, nearest)
    wanted_m = target.along_m + OPTIONS.arrow_ahead_m
    for row in range(nearest.row + 1, len(route.points)):
        end = route.points[row]
        if end.floor != floor:
            break
        while wanted_m <= end.along_m:
            target = _on_way(route, _Nearest(row - 1, wanted_m, 0.0))
            if math.hypot(target.x - x, target.y - y) >= OPTIONS.arrow_clear_m:
                return angle_between_deg(heading_deg, math.degrees(math.atan2(target.y - y, target.x - x)))
            wanted_m += OPTIONS.arrow_step_m
        target = end
        if _turns_back(route, row):
            break
    if math.hypot(target.x - x, target.y - y) < OPTIONS.arrow_min_m:
        return None
    return angle_between_deg(heading_deg, math.degrees(math.atan2(target.y - y, target.x - x)))


def _after_turning_back(route: Route, nearest: _Nearest) -> _Nearest:
    """Return the point where the route turns back, when that is next and near, else the nearest point as given.

    A walker so close to the point has been there: otherwise the arrow would point to it and away from it in turns.
    """
    row = nearest.row + 1
    if row >= len(route.points) or not _turns_back(route, row):
        return nearest
    along_m = route.points[row].along_m
    return (
        _Nearest(row, along_m, nearest.away_m)
        if along_m - nearest.along_m < OPTIONS.arrow_clear_m
        else nearest
    )


def _turns_back(route: Route, row: int) -> bool:
    """Return whether the route turns back at a point, as at the end of a dead end that leads to a landmark."""
    here, points = route.points[row], route.points
    before = next(
        (p for p in reversed(points[:row]) if p.along_m <= here.along_m - OPTIONS.back_m), points[0]
    )
    after = next((p for p in points[row + 1 :] if p.along_m >= here.along_m + OPTIONS.back_m), points[-1])
    if (
        not before.floor == here.floor == after.floor
        or min(_apart_m(before, here), _apart_m(here, after)) == 0
    ):
        return False
    came_deg = math.degrees(math.atan2(here.y - before.y, here.x - before.x))
    goes_deg = math.degrees(math.atan2(after.y - here.y, after.x - here.x))
    return abs(angle_between_deg(came_deg, goes_deg)) > OPTIONS.back_deg


def _on_way(route: Route, nearest: _Nearest) -> RoutePoint:
    """Return the point of the route as a point of its line."""
    a = route.points[nearest.row]
    b = route.points[min(nearest.row + 1, len(route.points) - 1)]
    length_m = b.along_m - a.along_m
    fraction = 0.0 if length_m <= 0 or b.floor != a.floor else (nearest.along_m - a.along_m) / length_m
    return RoutePoint(a.floor, a.x + fraction * (b.x - a.x), a.y + fraction * (b.y - a.y), nearest.along_m)
