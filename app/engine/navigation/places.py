"""Where a route begins or ends: a landmark or POI by id, or a point on a floor's plan."""

from __future__ import annotations

import re
from dataclasses import dataclass

from app.engine.floors.model import Landmark
from app.engine.floors.options import OPTIONS as FLOOR
from app.engine.floors.sentences import listed, short
from app.engine.navigation.network import Network
from app.errors import InvalidInputError, NotFoundError

NUMBER = r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?\s*"
POINT = re.compile(rf"([^:]*):({NUMBER}),({NUMBER})")
# What can be a point that was written in another way.
NUMBERS = re.compile(r"[-+\d.,;\s]+")


@dataclass(frozen=True, slots=True)
class PlanPlace:
    """A point on a floor's plan, in metres."""

    floor: str
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class NamedPlace:
    """A landmark or POI on its floor."""

    floor: str
    landmark: Landmark


Place = PlanPlace | NamedPlace


def parse_place(text: str, network: Network, field: str) -> Place:
    """Return the place of a text: an id, `floor:id` or `floor:x,y`.

    `field` is the name of the parameter in messages. Raises `NotFoundError` for an unknown floor or id,
    `InvalidInputError` for an id on several floors or for numbers too large for a plan.
    """
    wanted = text.strip()
    if not wanted:
        raise InvalidInputError(f"{field} is empty; give a landmark's id or floor:x,y.")
    found = network.places_named(wanted)
    if len(found) == 1:
        return NamedPlace(*found[0])
    if found:
        choices = listed([f"{floor}:{wanted}" for floor, _ in found])
        raise InvalidInputError(f"{field}: {short(wanted)} is on several floors; say which: {choices}.")
    floor_id, colon, rest = wanted.partition(":")
    if not colon:
        meant = _probably_meant(wanted, network)
        raise NotFoundError(f"{field}: there is no landmark or poi {short(wanted)} in this venue{meant}.")
    part = network.parts.get(floor_id)
    if part is None:
        raise NotFoundError(
            f"{field}: there is no floor {short(floor_id)}; there are {listed([*network.parts])}."
        )
    features = part.places.features
    mark = features.landmarks.get(rest) or features.pois.get(rest)
    if mark is not None:
        return NamedPlace(floor_id, mark)
    point = POINT.fullmatch(wanted)
    if point is None:
        meant = _probably_meant(rest, network)
        raise NotFoundError(f"{field}: floor {short(floor_id)} has no landmark or poi {short(rest)}{meant}.")
    x, y = float(point[2]), float(point[3])
    if not max(abs(x), abs(y)) <= FLOOR.max_coordinate_m:
        raise InvalidInputError(f"{field}: x and y must be within {FLOOR.max_coordinate_m:,.0f} m.")
    return PlanPlace(floor_id, x, y)


def _probably_meant(text: str, network: Network) -> str:
    """Return the end of the sentence about a text that is no id: the ids of what has it as its name, or how a point is
    written; empty where nothing is like it."""
    if NUMBERS.fullmatch(text) and any(map(str.isdigit, text)):
        return "; a point is floor:x,y, such as 0:12.5,3"
    wanted, floors = text.casefold(), [part.places.features for part in network.parts.values()]
    marks = [mark for one in floors for group in (one.landmarks, one.pois) for mark in group.values()]
    same = [mark.id for mark in marks if wanted in (mark.id.casefold(), mark.name.casefold())]
    if same:
        return f"; did you mean {listed(same)}? Places are named by their ids"
    if any(wanted in (area.id.casefold(), area.name.casefold()) for one in floors for area in one.areas):
        return "; it is an area, and routes lead to a landmark or a point, floor:x,y"
    return ""
