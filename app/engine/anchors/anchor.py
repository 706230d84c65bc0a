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


@dataclass(frozen=True, slots=True, kw_only=True)
class AroundPlace:
    """What a phone may see from around a point of a floor's plan: POIs within `sees_m` of it and `half_view_deg` of the
    direction `heading_deg`, counter-clockwise from plan x; it is within `phone_m` of the point."""

    floor_id: str
    x: float
    y: float
    phone_m: float
    heading_deg: float
    half_view_deg: float
    sees_m: float

    def has_anchor(self, spec: AnchorSpec, *, has_walls: bool = False) -> bool:
        """Whether the phone may see one of an anchor's POIs: without that the anchor places no phone, unless its floor
        `has_walls`, which give the scale of whatever both see; then the anchor need only be near."""
        if spec.floor_id != self.floor_id:
            return False
        is_near = math.hypot(spec.x - self.x, spec.y - self.y) <= self.sees_m + self.phone_m
        return (has_walls and is_near) or any(self._sees(poi.x, poi.y) for poi in spec.pois)

    def has_phone(self, x: float, y: float) -> bool:
        """Whether the phone can be at a point of the floor's plan."""
        return math.hypot(x - self.x, y - self.y) <= self.phone_m

    def _sees(self, x: float, y: float) -> bool:
        along_x, along_y = x - self.x, y - self.y
        away_m = math.hypot(along_x, along_y)
        if away_m <= self.phone_m:
            return True
        aside_deg = math.degrees(math.atan2(along_y, along_x)) - self.heading_deg
        # From elsewhere around the point the direction differs by up to this.
        parallax_deg = math.degrees(math.asin(min(self.phone_m / away_m, 1.0)))
        return away_m <= self.sees_m + self.phone_m and (
            abs((aside_deg + 180.0) % 360.0 - 180.0) <= self.half_view_deg + parallax_deg
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorSearch:
    """What is known of a phone before anchors are asked: it is `around` a place, or its fix is `to_be_confirmed` by a
    second one."""

    around: AroundPlace | None = None
    to_be_confirmed: bool = False

    @property
    def may_be_rough(self) -> bool:
        """Whether less exact fixes are of use."""
        return self.to_be_confirmed or self.around is not None

    def has_phone(self, x: float, y: float) -> bool:
        """Whether the phone can be at a point of the floor's plan."""
        return self.around is None or self.around.has_phone(x, y)


ANYWHERE = AnchorSearch()


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
