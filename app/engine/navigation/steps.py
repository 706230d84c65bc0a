"""The steps of a route: where to turn, which landmarks are passed, where to change floors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.model import Landmark, LinkMode
from app.engine.navigation.model import Passage, Route, RoutePoint, Step, Turn
from app.engine.navigation.network import Network
from app.engine.navigation.places import NamedPlace, Place
from app.engine.navigation.search import Way
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOptions:
    """Which bends of a way are turns, and which landmarks belong to a step."""

    smooth_m: float = limit(
        0.5,
        "Bends that deviate less than this from a straight line are ignored.",
        chosen="By hand: such bends come from how a line was drawn.",
    )
    one_turn_m: float = limit(
        2.0,
        "Turns closer together than this are one turn.",
        chosen="By hand: going around a table or through a door at an angle is one movement.",
    )
    end_m: float = limit(
        1.0,
        "Turns closer than this to the end of the way are not said.",
        chosen="By hand: the destination is in sight by then.",
    )
    short_m: float = limit(
        0.5,
        "A first step shorter than this is left out, and landmarks this close to a step's start or end belong to it.",
        chosen="By hand: about one stride.",
    )
    beside_m: float = limit(
        1.0, "A landmark this close to the way is passed by it.", chosen="By hand: near enough to point at."
    )
    at_m: float = limit(
        2.0,
        "A turn is said to be at a landmark that is passed within this distance along the way.",
        chosen="By hand: as far apart as turns that are said as one.",
    )
    slight_deg: float = limit(
        30.0,
        "Smallest change of direction that is said.",
        chosen="By hand: people follow smaller bends without thinking.",
    )
    turn_deg: float = limit(
        60.0,
        "From this change of direction on a turn is not slight.",
        chosen="By hand: two thirds of a right angle.",
    )
    sharp_deg: float = limit(
        120.0,
        "From this change of direction on a turn is sharp.",
        chosen="By hand: as far above a right angle as `turn_deg` is below.",
    )
    u_turn_deg: float = limit(
        160.0,
        "From this change of direction on a turn leads back.",
        chosen="By hand: 20 degrees short of a half turn.",
    )


OPTIONS = StepOptions()


def turn_of(angle_deg: float) -> Turn:
    """Return the name of a change of direction, -180 to 180 degrees counter-clockwise."""
    size = abs(angle_deg)
    if size < OPTIONS.slight_deg:
        return "straight"
    if size >= OPTIONS.u_turn_deg:
        return "u_turn"
    left = angle_deg > 0
    if size < OPTIONS.turn_deg:
        return "slight_left" if left else "slight_right"
    if size < OPTIONS.sharp_deg:
        return "left" if left else "right"
    return "sharp_left" if left else "sharp_right"


def angle_between_deg(before_deg: float, after_deg: float) -> float:
    """Return the change from one direction to another, -180 to 180 degrees counter-clockwise."""
    return (after_deg - before_deg + 180.0) % 360.0 - 180.0


@dataclass(frozen=True, slots=True)
class _Section:
    """A part of a route on one floor by one mode: rows `first` to `last` of its points."""

    mode: LinkMode
    first: int
    last: int


def make_route(network: Network, start: Place, end: Place, way: Way, heading_deg: float | None) -> Route:
    """Return the route of a way, with its landmarks and steps.

    With `heading_deg`, where the walker looks counter-clockwise from plan x, the first step is a turn from there.
    """
    passages = _passages(network, way.points)
    sections = _sections(way)
    names = {floor_id: part.floor.name for floor_id, part in network.parts.items()}
    levels = {floor_id: part.floor.level for floor_id, part in network.parts.items()}
    steps: list[Step] = []
    for section in sections:
        if section.mode == "walk":
            enters = section.first > 0
            heading = heading_deg if section.first == 0 else None
            steps += _walk_steps(way.points[section.first : section.last + 1], heading, enters)
        else:
            steps.append(_change(way.points, section, levels))
    steps.append(_step("arrive", way.points[-1]))
    if len(steps) > 1 and steps[0].turn == "depart" and steps[1].along_m < OPTIONS.short_m:
        steps = steps[1:]
    named = _with_landmarks(_with_distances(steps, way.points[-1].along_m), passages, start, end)
    return Route(
        start=start,
        end=end,
        points=way.points,
        modes=way.modes,
        passages=passages,
        steps=named,
        floor_names=names,
    )


def _sections(way: Way) -> list[_Section]:
    sections: list[_Section] = []
    for row, mode in enumerate(way.modes):
        last = sections[-1] if sections else None
        begins_anew = mode != "walk" and way.points[row].floor != way.points[row - 1].floor and row > 0
        if last is not None and last.mode == mode and not begins_anew:
            sections[-1] = replace(last, last=row + 1)
        else:
            sections.append(_Section(mode, row, row + 1))
    return sections


def _step(turn: Turn, point: RoutePoint) -> Step:
    return Step(turn=turn, floor=point.floor, x=point.x, y=point.y, along_m=point.along_m, distance_m=0.0)


def _change(points: Sequence[RoutePoint], section: _Section, levels: dict[str, int]) -> Step:
    first, last = points[section.first], points[section.last]
    turn: Turn = "up" if levels[last.floor] >= levels[first.floor] else "down"
    return replace(_step(turn, first), mode=section.mode, to_floor=last.floor)


def _walk_steps(points: Sequence[RoutePoint], heading_deg: float | None, enters_floor: bool) -> list[Step]:
    """Return the steps of a walk on one floor: one where it begins, one for each turn."""
    places = np.array([(point.x, point.y) for point in points])
    along = np.array([point.along_m for point in points])
    corners = _corners(places)
    if len(corners) < 2:
        return []
    directions = _directions_deg(places[corners])
    first, *groups = _turn_groups(along[corners])
    begin: Turn = "straight" if enters_floor else "depart"
    if heading_deg is not None:
        begin = turn_of(angle_between_deg(heading_deg, directions[first[-1]]))
    steps = [replace(_step(begin, points[0]), enters_floor=enters_floor)]
    for group in groups:
        angle_deg = angle_between_deg(directions[group[0] - 1], directions[group[-1]])
        turn = turn_of(angle_deg)
        if turn != "straight":
            steps.append(_step(turn, points[corners[group[0]]]))
    return steps


def _corners(places: Array) -> list[int]:
    """Return the rows of the points that remain without bends smaller than `smooth_m` (Douglas-Peucker)."""
    simple = shapely.get_coordinates(
        shapely.LineString(places).simplify(OPTIONS.smooth_m, preserve_topology=False)
    )
    rows, row = [], 0
    for x, y in simple:
        while row < len(places) and not (places[row, 0] == x and places[row, 1] == y):
            row += 1
        if row < len(places):
            rows.append(row)
            row += 1
    return rows


def _directions_deg(corners: Array) -> Array:
    along = np.diff(corners, axis=0)
    return np.asarray(np.degrees(np.arctan2(along[:, 1], along[:, 0])))


def _turn_groups(along_m: Array) -> list[list[int]]:
    """Return the corners but the last, grouped into turns; the first group holds the start.

    A turn less than `end_m` before the end is left out.
    """
    groups = [[0]]
    for corner in range(1, len(along_m) - 1):
        if along_m[corner] - along_m[groups[-1][-1]] < OPTIONS.one_turn_m:
            groups[-1].append(corner)
        elif along_m[-1] - along_m[corner] >= OPTIONS.end_m:
            groups.append([corner])
    return groups


def _with_distances(steps: list[Step], total_m: float) -> list[Step]:
    ends = [*(step.along_m for step in steps[1:]), total_m]
    return [replace(step, distance_m=end - step.along_m) for step, end in zip(steps, ends, strict=True)]


def _passages(network: Network, points: Sequence[RoutePoint]) -> tuple[Passage, ...]:
    """Return the landmarks within `beside_m` of the way, in the order in which they are passed."""
    found: list[Passage] = []
    for floor_id, part in network.parts.items():
        landmarks = list(part.places.features.landmarks.values())
        pieces = [(a, b) for a, b in pairwise(points) if a.floor == b.floor == floor_id]
        alone = [(a, a) for a in points if a.floor == floor_id] if not pieces else []
        if not landmarks or not (pieces or alone):
            continue
        lines = shapely.linestrings([[(a.x, a.y), (b.x, b.y)] for a, b in pieces or alone])
        marks = shapely.points([(mark.x, mark.y) for mark in landmarks])
        index, piece = shapely.STRtree(lines).query_nearest(
            marks, max_distance=OPTIONS.beside_m, all_matches=False
        )
        for k, row in zip(index, piece, strict=True):
            a, b = (pieces or alone)[row]
            on_line = a is not b
            fraction = (
                float(shapely.line_locate_point(lines[row], marks[k], normalized=True)) if on_line else 0.0
            )
            found.append(Passage(floor_id, landmarks[k], a.along_m + fraction * (b.along_m - a.along_m)))
    return tuple(sorted(found, key=lambda passage: passage.along_m))


def _with_landmarks(
    steps: list[Step], passages: tuple[Passage, ...], start: Place, end: Place
) -> tuple[Step, ...]:
    named: list[Step] = []
    goal = end.landmark if isinstance(end, NamedPlace) else None
    origin = start.landmark if isinstance(start, NamedPlace) else None
    for step in steps:
        own = [passage for passage in passages if passage.floor == step.floor]
        at = _nearest(own, step.along_m)
        if step.turn == "arrive":
            at = goal
        elif step is steps[0]:
            at = origin
        reach = step.along_m + step.distance_m
        first_m, last_m = step.along_m + OPTIONS.short_m, reach + OPTIONS.short_m
        ahead = [p for p in own if first_m < p.along_m <= last_m and p.landmark is not at]
        if step.turn in ("up", "down", "arrive"):
            ahead = []
        towards = ahead[-1].landmark if ahead else None
        is_last = step is steps[-2] if len(steps) > 1 else False
        if is_last and goal is not None and goal is not at and step.turn not in ("up", "down"):
            towards = goal
        passing = tuple(p.landmark for p in ahead if p.landmark is not towards)
        named.append(replace(step, at=at, towards=towards, passing=passing))
    return tuple(named)


def _nearest(passages: list[Passage], along_m: float) -> Landmark | None:
    near = [passage for passage in passages if abs(passage.along_m - along_m) <= OPTIONS.at_m]
    best = min(near, key=lambda passage: abs(passage.along_m - along_m), default=None)
    return None if best is None else best.landmark
