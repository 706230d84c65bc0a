"""The features of one floor as values. All coordinates are plan metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

Kind = Literal["landmark", "poi", "area", "link"]
LinkMode = Literal["walk", "stairs", "lift", "escalator"]
KINDS: tuple[Kind, ...] = get_args(Kind)
LINK_MODES: tuple[LinkMode, ...] = get_args(LinkMode)


@dataclass(frozen=True, slots=True)
class Landmark:
    """A named point: a destination, and a place that guidance names. POIs are of this type too."""

    id: str
    name: str
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Area:
    """A room or region: `polygon` is a valid shapely Polygon."""

    id: str
    name: str
    category: str | None
    polygon: shapely.Polygon


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A way to walk along `points` (n, 2), n >= 2, or with `to_floor` the way from its first point to that floor.

    `start` and `end` are ids of landmarks or None; `end` is one of `to_floor` if that is set. `length_m` is the length
    that the client gave for a way between floors, else None.
    """

    id: str
    name: str | None
    mode: LinkMode
    accessible: bool
    one_way: bool
    points: NDArray[np.float64]
    start: str | None
    end: str | None
    to_floor: str | None
    length_m: float | None


@dataclass(frozen=True, slots=True)
class FloorFeatures:
    """All features of a floor; landmarks and POIs by id."""

    landmarks: Mapping[str, Landmark] = field(default_factory=dict)
    pois: Mapping[str, Landmark] = field(default_factory=dict)
    areas: tuple[Area, ...] = ()
    links: tuple[Link, ...] = ()

    @property
    def counts(self) -> dict[Kind, int]:
        """How many there are of each kind."""
        return {
            "landmark": len(self.landmarks),
            "poi": len(self.pois),
            "area": len(self.areas),
            "link": len(self.links),
        }
