"""An anchor: a monitoring camera on a floor's plan, with the POIs that it sees (C 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from app.geometry.camera_hint import CameraHint


@dataclass(frozen=True, slots=True, kw_only=True)
class Poi:
    """A point of interest of an anchor: the corners of its region in the camera's frame, its position on the plan in
    metres, its distance from the camera, and its height on the plan's z axis, if known."""

    id: str
    region_px: tuple[tuple[float, float], ...]
    x: float
    y: float
    distance_m: float
    height_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorSpec:
    """A monitoring camera as a request describes it.

    `camera` may be without an image size, which is then that of the frames.
    """

    venue_id: str
    floor_id: str
    x: float
    y: float
    height_m: float
    heading_deg: float | None
    camera: CameraHint
    pois: tuple[Poi, ...]
    store_images: bool = False
    max_age_s: float | None = None


@dataclass(frozen=True, slots=True)
class AroundPlace:
    """What may be seen from around a point of a floor's plan: anchors within `anchors_m` of it, by which a phone is
    placed within `phone_m` of it, metres."""

    floor_id: str
    x: float
    y: float
    anchors_m: float
    phone_m: float

    def has_anchor(self, spec: AnchorSpec) -> bool:
        """Whether an anchor may be seen from there."""
        is_near = math.hypot(spec.x - self.x, spec.y - self.y) <= self.anchors_m
        return spec.floor_id == self.floor_id and is_near

    def has_phone(self, x: float, y: float) -> bool:
        """Whether a phone can be at a point of the floor's plan."""
        return math.hypot(x - self.x, y - self.y) <= self.phone_m


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
