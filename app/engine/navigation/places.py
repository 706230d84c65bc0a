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
        raise NotFoundError(f"{field}: there is no landmark or poi {short(wanted)} in this venue.")
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
        raise NotFoundError(f"{field}: floor {short(floor_id)} has no landmark or poi {short(rest)}.")
    x, y = float(point[2]), float(point[3])
    if not max(abs(x), abs(y)) <= FLOOR.max_coordinate_m:
        raise InvalidInputError(f"{field}: x and y must be within {FLOOR.max_coordinate_m:,.0f} m.")
    return PlanPlace(floor_id, x, y)
