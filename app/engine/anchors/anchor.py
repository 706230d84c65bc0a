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
    """The anchors of a floor within a distance of a point of its plan, metres."""

    floor_id: str
    x: float
    y: float
    within_m: float

    def holds(self, spec: AnchorSpec) -> bool:
        """Whether an anchor is one of them."""
        is_near = math.hypot(spec.x - self.x, spec.y - self.y) <= self.within_m
        return spec.floor_id == self.floor_id and is_near


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
