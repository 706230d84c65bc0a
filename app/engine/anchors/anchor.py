"""An anchor: a monitoring camera on a floor's plan, with the POIs that it sees (C 3)."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from app.geometry.camera import Camera


@dataclass(frozen=True, slots=True, kw_only=True)
class Poi:
    """A point of interest of an anchor: its corners in the camera's picture (pixels), its place on the plan, its
    distance from the camera, and its height on the plan's z axis, if known."""

    id: str
    region_px: tuple[tuple[float, float], ...]
    x: float
    y: float
    distance_m: float
    height_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorSpec:
    """What a `PUT` says of a monitoring camera. `camera` is a `Camera`, or the numbers of one for its frames as
    they come."""

    venue_id: str
    floor_id: str
    x: float
    y: float
    height_m: float
    heading_deg: float | None
    camera: Camera | tuple[float, ...]
    pois: tuple[Poi, ...]
    store_images: bool = False
    max_age_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Anchor:
    """A stored anchor. `calibration` is the camera's pose in the map, as the calibration found it."""

    id: str
    spec: AnchorSpec
    calibration: dict[str, Any] | None
    uses: int
    last_used_at: datetime | None
    created_at: datetime
    updated_at: datetime
