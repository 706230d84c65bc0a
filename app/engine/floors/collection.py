"""Reads a whole FeatureCollection: from the bytes of a request to checked features in one form."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.engine.floors.checks import check_links
from app.engine.floors.coordinate_checks import check_coordinates
from app.engine.floors.floor import PlanImage
from app.engine.floors.model import KINDS, Area, FloorFeatures, Kind, Landmark, Link
from app.engine.floors.origin import Origin, read_origin
from app.engine.floors.other_formats import other_format, other_json
from app.engine.floors.reading import (
    GeoJson,
    Value,
    as_geojson,
    given_id,
    kind_of,
    position_count,
    raw_id,
    read_link,
    read_named,
)
from app.engine.floors.sentences import short
from app.errors import InvalidInputError
from app.limits import limit

POINTS: tuple[Kind, ...] = ("landmark", "poi")


@dataclass(frozen=True, slots=True, kw_only=True)
class CollectionOptions:
    """How large a floor's features may be."""

    max_features: int = limit(
        20_000,
        "Features of a floor.",
        chosen="By hand: ten times a large hospital floor, and still read in seconds.",
    )
    max_positions: int = limit(
        200_000,
        "Positions of all features of a floor together.",
        chosen="By hand: ten positions a feature at the largest number of features.",
    )
    max_depth: int = limit(
        12,
        "Levels of nesting in the JSON.",
        chosen="By hand: GeoJSON needs 8, and what else is in the properties is given a few more.",
    )


OPTIONS = CollectionOptions()
TOO_DEEP = f"The JSON is nested more than {OPTIONS.max_depth} deep."


def parse_json(data: bytes) -> object:
    """Return the JSON of a request; raises `InvalidInputError` for JSON that can't be stored and returned unchanged."""
    try:
        value = json.loads(data, parse_constant=_refuse_constant)
        _check_depth(value)
        json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
    except RecursionError:
        raise InvalidInputError(TOO_DEEP) from None
    except UnicodeError:
        found = other_format(data) or "The body is not valid UTF-8 text"
        raise InvalidInputError(f"{found}; send a GeoJSON FeatureCollection.") from None
    except ValueError as error:
        what = other_format(data)
        if what is not None:
            raise InvalidInputError(f"{what}; send a GeoJSON FeatureCollection.") from None
        reason = f": {error}" if isinstance(error, json.JSONDecodeError) else " with finite numbers"
        raise InvalidInputError(f"The body must be a GeoJSON FeatureCollection{reason}.") from None
    return value


def _refuse_constant(_: str) -> None:
    raise ValueError


def _check_depth(value: object) -> None:
    level: list[Any] = [value]
    for _ in range(OPTIONS.max_depth):
        level = [
            child
            for item in level
            if isinstance(item, dict | list)
            for child in (item.values() if isinstance(item, dict) else item)
        ]
        if not level:
            return
    raise InvalidInputError(TOO_DEEP)


def parse_features(
    value: object, floor_id: str, floor_ids: Sequence[str], plan: PlanImage | None = None
) -> tuple[GeoJson, FloorFeatures]:
    """Return a floor's features as they are stored, in plan metres, and as values; `plan` is the floor's image.

    Links must touch something at each end on this floor, and lead to one of `floor_ids`. Their ends on the other floor
    are not checked, since the features of that floor may come later. Raises `InvalidInputError` that names the feature,
    or says in which units the coordinates seem to be.
    """
    collection, features = read_collection(value, floor_id)
    if isinstance(value, Mapping) and value.get("origin") is None:
        check_coordinates(features, plan)
    check_links(features, floor_ids)
    return collection, features


def read_collection(value: object, floor_id: str) -> tuple[GeoJson, FloorFeatures]:
    """Return the features as they are stored and as values. Features are not checked against each other, except that
    ids must differ."""
    if not isinstance(value, Mapping) or value.get("type") != "FeatureCollection":
        raise InvalidInputError(
            f'The body must be a GeoJSON object with "type": "FeatureCollection"{other_json(value)}.'
        )
    check_bbox(value)
    entries = value.get("features")
    if not isinstance(entries, list):
        raise InvalidInputError("A FeatureCollection has a list of features.")
    if len(entries) > OPTIONS.max_features:
        raise InvalidInputError(
            f"There are {len(entries):,} features; a floor holds {OPTIONS.max_features:,} at most."
        )
    reader = _Reader(floor_id, read_origin(value))
    stored = [reader.read(index, entry) for index, entry in enumerate(entries)]
    return {"type": "FeatureCollection", "features": stored}, reader.features()


def check_bbox(value: object) -> None:
    """Raise `InvalidInputError` for a GeoJSON object whose bounding box is none: four numbers, six with heights (RFC
    7946, section 5). What it says is not used."""
    box = value.get("bbox") if isinstance(value, Mapping) else None
    if box is None:
        return
    is_box = isinstance(box, list) and len(box) in (4, 6)
    if not is_box or not all(isinstance(each, int | float) and not isinstance(each, bool) for each in box):
        raise InvalidInputError("bbox must be four or six numbers: west, south, (down,) east, north(, up).")


class _Reader:
    """Reads one feature after the other, and makes sure that their ids differ."""

    def __init__(self, floor_id: str, origin: Origin | None) -> None:
        self._floor_id = floor_id
        self._origin = origin
        self._values: dict[Kind, dict[str, Value]] = {kind: {} for kind in KINDS}
        self._positions = 0
        self._repeats: Counter[tuple[str, str]] = Counter()

    def read(self, index: int, entry: object) -> GeoJson:
        try:
            return self._read(index, entry)
        except InvalidInputError as error:
            raise InvalidInputError(f"Feature {index}{_name(entry)}: {error}") from None

    def _read(self, index: int, entry: object) -> GeoJson:
        if not isinstance(entry, Mapping) or entry.get("type") != "Feature":
            raise InvalidInputError('it must be an object with "type": "Feature".')
        check_bbox(entry)
        check_bbox(entry.get("geometry"))
        properties = entry.get("properties")
        if not isinstance(properties, Mapping):
            raise InvalidInputError(
                f"it has no properties; it needs at least kind, one of {', '.join(KINDS)}, and a name."
            )
        kind = kind_of(properties)
        feature_id = given_id(entry, properties)
        value: Value
        if kind == "link":
            own = feature_id or self._free(f"link-{index}", kind)
            value = read_link(own, entry, self._floor_id, self._origin)
        else:
            if feature_id is None and isinstance(properties.get("name"), str):
                feature_id = self._free(properties["name"].strip(), kind)
            value = read_named(kind, feature_id, entry, self._origin)
        if self._is_taken(value.id, kind):
            also = "landmark or poi" if kind in POINTS else kind
            raise InvalidInputError(f"there is another {also} with the id {short(value.id)} on this floor.")
        self._positions += position_count(value)
        if self._positions > OPTIONS.max_positions:
            raise InvalidInputError(
                f"the features up to here have more than {OPTIONS.max_positions:,} positions."
            )
        self._values[kind][value.id] = value
        return as_geojson(kind, value, properties)

    def _is_taken(self, feature_id: str, kind: Kind) -> bool:
        return any(feature_id in self._values[other] for other in (POINTS if kind in POINTS else (kind,)))

    def _free(self, wanted: str, kind: Kind) -> str:
        """Return an id for a feature without one: `wanted`, with a number appended where that is taken."""
        free = wanted
        while self._is_taken(free, kind):
            self._repeats[kind, wanted] += 1
            free = f"{wanted} ({self._repeats[kind, wanted] + 1})"
        return free

    def features(self) -> FloorFeatures:
        values = self._values
        return FloorFeatures(
            {key: value for key, value in values["landmark"].items() if isinstance(value, Landmark)},
            {key: value for key, value in values["poi"].items() if isinstance(value, Landmark)},
            tuple(value for value in values["area"].values() if isinstance(value, Area)),
            tuple(value for value in values["link"].values() if isinstance(value, Link)),
        )


def _name(entry: object) -> str:
    """Return the id or name that a message shows beside a feature's index."""
    if not isinstance(entry, Mapping):
        return ""
    properties = entry.get("properties")
    inside = properties if isinstance(properties, Mapping) else {}
    own = raw_id(entry, inside)
    name = inside.get("name") if own is None else own
    return f" ({short(name)})" if isinstance(name, str | int) else ""
