"""Reads one GeoJSON Feature, of which several spellings are understood, and writes the one that is stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from unicodedata import category

import shapely  # type: ignore[import-untyped]

from app.engine.floors.geometry import read_line, read_point, read_polygon
from app.engine.floors.model import KINDS, LINK_MODES, Area, Kind, Landmark, Link, LinkMode
from app.engine.floors.origin import Origin
from app.engine.floors.sentences import short
from app.errors import InvalidInputError
from app.limits import limit

GeoJson = dict[str, Any]
Value = Landmark | Area | Link

KIND_KEYS = ("kind", "type", "class", "feature_type")
# A link's mode stands under one of these keys, or under one of `KIND_KEYS` that doesn't hold the kind.
MODE_KEYS = ("mode", "link_kind", "link_type")
MODE_WORDS: dict[str, LinkMode] = {
    **{mode: mode for mode in LINK_MODES},
    "elevator": "lift", "stair": "stairs", "staircase": "stairs", "walkway": "walk", "pathway": "walk",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """Which values the properties of a feature may have."""

    max_text: int = limit(
        200,
        "Characters of an id or name.",
        chosen="By hand: as many as the names of venues and floors may have.",
    )
    max_length_m: float = limit(
        10_000.0,
        "Length that a client may give for a way between floors.",
        chosen="By hand: no venue is larger, and a length in millimetres for one floor is refused.",
    )


OPTIONS = ReadingOptions()


def kind_of(properties: Mapping[str, Any]) -> Kind:
    """Return the kind that a feature's properties name; raises `InvalidInputError`."""
    words = [properties[key] for key in KIND_KEYS if isinstance(properties.get(key), str)]
    for word in words:
        for kind in KINDS:
            if word.strip().lower() == kind:
                return kind
    if any(word.strip().lower() in MODE_WORDS for word in words):
        return "link"
    said = f", not {short(words[0])}" if words else ""
    raise InvalidInputError(f"properties.kind must be one of {', '.join(KINDS)}{said}.")


def given_id(feature: Mapping[str, Any], properties: Mapping[str, Any]) -> str | None:
    """Return the id in the properties or beside them, a whole number as text; None without one.

    Raises `InvalidInputError`.
    """
    return _reference(raw_id(feature, properties), "id")


def raw_id(feature: Mapping[str, Any], properties: Mapping[str, Any]) -> object:
    """Return the id in the properties or beside them as it was given, None without one.

    An empty one counts as none: drawing tools write an empty field `id` beside the feature's own id.
    """
    for value in (properties.get("id"), feature.get("id")):
        if value is not None and not (isinstance(value, str) and not value.strip()):
            return value
    return None


def read_named(
    kind: Kind, feature_id: str | None, feature: Mapping[str, Any], origin: Origin | None
) -> Landmark | Area:
    """Return a landmark, POI or area, whose id is its name when it has none; raises `InvalidInputError`."""
    properties = feature["properties"]
    if properties.get("name") is None:
        raise InvalidInputError(f"{'an' if kind == 'area' else 'a'} {kind} needs properties.name.")
    name = _text(properties["name"], "name")
    own = feature_id or name
    if kind == "area":
        category = properties.get("category")
        text = None if category is None else _text(category, "category")
        return Area(own, name, text, read_polygon(feature.get("geometry"), origin))
    x, y = read_point(feature.get("geometry"), kind, origin)
    return Landmark(own, name, float(x), float(y))


def read_link(feature_id: str, feature: Mapping[str, Any], floor_id: str, origin: Origin | None) -> Link:
    """Return a link; raises `InvalidInputError`."""
    properties = feature["properties"]
    mode = _mode(properties)
    name = properties.get("name")
    to_floor = _to_floor(properties, mode, floor_id)
    points = read_line(feature.get("geometry"), mode, origin)
    points.setflags(write=False)
    return Link(
        id=feature_id,
        name=None if name is None else _text(name, "name"),
        mode=mode,
        accessible=_flag(properties, "accessible", mode in ("walk", "lift")),
        one_way=_flag(properties, "one_way", False),
        points=points,
        start=_end(properties, "from"),
        end=_end(properties, "to"),
        to_floor=to_floor,
        length_m=_length(properties),
    )


def _mode(properties: Mapping[str, Any]) -> LinkMode:
    for key in MODE_KEYS:
        if properties.get(key) is not None:
            word = str(properties[key]).strip().lower()
            if word not in MODE_WORDS:
                raise InvalidInputError(
                    f"{key} must be one of {', '.join(LINK_MODES)}, not {short(properties[key])}."
                )
            return MODE_WORDS[word]
    others = [str(properties[key]).strip().lower() for key in KIND_KEYS if properties.get(key) is not None]
    others = [word for word in others if word not in KINDS]
    for word in others:
        if word in MODE_WORDS:
            return MODE_WORDS[word]
    if others:
        raise InvalidInputError(
            f"a link's kind must be one of {', '.join(LINK_MODES)}, not {short(others[0])}."
        )
    return "walk"


def _to_floor(properties: Mapping[str, Any], mode: LinkMode, floor_id: str) -> str | None:
    value = properties.get("to_floor")
    to_floor = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
    if to_floor is not None:
        to_floor = _text(to_floor, "to_floor")
    if mode == "walk":
        if to_floor not in (None, floor_id):
            raise InvalidInputError(
                f"a walk link can't cross to floor {short(to_floor)}; give its mode: stairs, lift or escalator."
            )
        return None
    if to_floor is None:
        raise InvalidInputError(f"a link by {mode} needs to_floor, the id of the floor that it leads to.")
    if to_floor == floor_id:
        raise InvalidInputError(f"to_floor is the link's own floor {short(floor_id)}; name the other one.")
    return to_floor


def _end(properties: Mapping[str, Any], key: str) -> str | None:
    """Return the id of the landmark at an end of a link, under one of two keys."""
    value = properties.get(key)
    return _reference(properties.get(f"{key}_landmark") if value is None else value, key)


def _reference(value: object, key: str) -> str | None:
    """Return an id, a whole number as text."""
    if value is None:
        return None
    if (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and value == value // 1
        and abs(value) < 10**18
    ):
        # Tables write a column of whole numbers as 7.0.
        return str(int(value))
    return _text(value, key)


def _length(properties: Mapping[str, Any]) -> float | None:
    value = properties.get("length_m")
    if value is None:
        return None
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not 0 <= value <= OPTIONS.max_length_m
    ):
        raise InvalidInputError(f"length_m must be a number from 0 to {OPTIONS.max_length_m:,.0f}.")
    return float(value)


def _flag(properties: Mapping[str, Any], key: str, default: bool) -> bool:
    value = properties.get(key)
    if value is None:
        return default
    if not isinstance(value, bool):
        raise InvalidInputError(f"{key} must be true or false, not {short(value)}.")
    return value


def _text(value: object, name: str) -> str:
    text = value.strip() if isinstance(value, str) else ""
    if not any(map(str.isprintable, text)) or len(text) > OPTIONS.max_text or not _is_one_line(text):
        raise InvalidInputError(
            f"{name} must be a text of 1 to {OPTIONS.max_text} printable characters, without line breaks."
        )
    return text


def _is_one_line(text: str) -> bool:
    """Whether a text holds no control character and no line break. Other spaces than the usual one, and what joins or
    directs the letters of a script, belong to names in many languages."""
    return not any(category(character) in ("Cc", "Cs", "Zl", "Zp") for character in text)


def position_count(value: Value) -> int:
    """Return how many positions a feature has."""
    if isinstance(value, Landmark):
        return 1
    return int(shapely.get_num_coordinates(value.polygon)) if isinstance(value, Area) else len(value.points)


def as_geojson(kind: Kind, value: Value, given: Mapping[str, Any]) -> GeoJson:
    """Return a feature as it is stored, in plan metres; properties that mean nothing here are kept."""
    properties: GeoJson = {**given, "kind": kind, "id": value.id, "name": value.name}
    if isinstance(value, Landmark):
        geometry: GeoJson = {"type": "Point", "coordinates": [value.x, value.y]}
    elif isinstance(value, Area):
        rings = [value.polygon.exterior, *value.polygon.interiors]
        coordinates = [shapely.get_coordinates(ring).tolist() for ring in rings]
        geometry = {"type": "Polygon", "coordinates": coordinates}
        properties["category"] = value.category
    else:
        geometry = {"type": "LineString", "coordinates": value.points.tolist()}
        own = {"from": value.start, "to": value.end, "to_floor": value.to_floor, "length_m": value.length_m}
        properties |= {"mode": value.mode, "accessible": value.accessible, "one_way": value.one_way, **own}
    kept = {key: item for key, item in properties.items() if item is not None}
    return {"type": "Feature", "id": value.id, "geometry": geometry, "properties": kept}
