"""What a build request says of the scale of a scan whose poses are estimated, parsed and validated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.engine.mapping.option_values import number
from app.errors import InvalidInputError

Point = tuple[float, float]

KINDS = {
    "distance_m": ("frame", "pixels"),
    "marker_m": (),
    "camera_height_m": (),
    "correspondences": (),
}
MIN_CORRESPONDENCES = 3
HOW = (
    "scale must be one of {distance_m, frame, pixels: [[u, v], [u, v]]}, {marker_m}, {camera_height_m} and "
    "{correspondences: [{frame, plan: [x, y], pixel: [u, v] or nothing}, ...]}"
)


@dataclass(frozen=True, slots=True)
class KnownDistance:
    """The metres between what two pixels of one frame show."""

    distance_m: float
    frame: str
    pixels: tuple[Point, Point]


@dataclass(frozen=True, slots=True)
class KnownMarker:
    """The length in metres of the side of printed markers that are in view."""

    side_m: float


@dataclass(frozen=True, slots=True)
class KnownHeight:
    """The metres at which the camera was held above the floor."""

    height_m: float


@dataclass(frozen=True, slots=True)
class PlanPlace:
    """A point on the plan in metres: where the camera stood at a frame, or what a pixel of the frame shows."""

    frame: str
    plan: Point
    pixel: Point | None


@dataclass(frozen=True, slots=True)
class KnownPlaces:
    """Three or more points on the plan."""

    places: tuple[PlanPlace, ...]


Scale = KnownDistance | KnownMarker | KnownHeight | KnownPlaces


def parse_scale(value: object) -> Scale | None:
    """Return the scale of a JSON object, None for null; raises `InvalidInputError`."""
    if value is None:
        return None
    kind = next((kind for kind in KINDS if isinstance(value, Mapping) and kind in value), None)
    if kind is None or not isinstance(value, Mapping) or set(value) - {kind, *KINDS[kind]}:
        raise InvalidInputError(f"{HOW}.")
    if kind == "correspondences":
        return _places(value[kind])
    metres = _above_zero(value[kind], f"scale.{kind}")
    if kind == "marker_m":
        return KnownMarker(metres)
    if kind == "camera_height_m":
        return KnownHeight(metres)
    pixels = value.get("pixels")
    if not isinstance(pixels, list | tuple) or len(pixels) != 2:
        raise InvalidInputError("scale.pixels must be two pixels, [[u, v], [u, v]].")
    first, second = (_point(pixel, "scale.pixels") for pixel in pixels)
    return KnownDistance(metres, _frame(value.get("frame")), (first, second))


def kind_of(scale: Scale | None) -> str | None:
    """Return what a scale is stated by: the first word of its name in the options; None for no scale."""
    kinds = {KnownDistance: "distance", KnownMarker: "marker", KnownHeight: "camera_height"}
    return None if scale is None else kinds.get(type(scale), "correspondences")


def frames_of(scale: Scale | None) -> tuple[str, ...]:
    """Return the frames that a scale refers to: names, or seconds of a video."""
    if isinstance(scale, KnownDistance):
        return (scale.frame,)
    return tuple(place.frame for place in scale.places) if isinstance(scale, KnownPlaces) else ()


def _places(value: object) -> KnownPlaces:
    if not isinstance(value, Sequence) or len(value) < MIN_CORRESPONDENCES:
        raise InvalidInputError(f"scale.correspondences must be {MIN_CORRESPONDENCES} or more.")
    return KnownPlaces(tuple(_place(item) for item in value))


def _place(value: Any) -> PlanPlace:
    if not isinstance(value, Mapping) or set(value) - {"frame", "plan", "pixel"}:
        raise InvalidInputError(
            "Each of scale.correspondences must be {frame, plan: [x, y]}, with pixel: [u, v] for something in view."
        )
    pixel = value.get("pixel")
    return PlanPlace(
        _frame(value.get("frame")),
        _point(value.get("plan"), "scale.correspondences.plan"),
        None if pixel is None else _point(pixel, "scale.correspondences.pixel"),
    )


def _frame(value: object) -> str:
    if isinstance(value, str) and value:
        return value
    seconds = number(value, "scale.frame")
    if seconds is None or seconds < 0:
        raise InvalidInputError(
            "scale.frame must be the name of a photo or frame, or the seconds since a video's start."
        )
    return repr(seconds)


def _point(value: object, name: str) -> Point:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InvalidInputError(f"{name} must be two numbers.")
    first, second = (number(part, name) for part in value)
    if first is None or second is None:
        raise InvalidInputError(f"{name} must be two numbers.")
    return first, second


def _above_zero(value: object, name: str) -> float:
    metres = number(value, name)
    if metres is None or metres <= 0:
        raise InvalidInputError(f"{name} must be a number of metres above 0.")
    return metres
