"""A floor of a venue: its heights, its plan, and how the plan lies in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.importers.plan_images.tiles import TileGrid


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanTiles:
    """All pixels of a large plan, in tiles: the blob that holds them, and how they are cut.

    `reduced_by` pixels of them, along each side, are one pixel of the plan's image; the upper left corners agree.
    """

    blob: str
    grid: TileGrid
    reduced_by: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanImage:
    """The image of a floor's plan: blob, media type and size; `origin_px` is the pixel (u, v) of plan (0, 0).

    A plan of many pixels has `tiles` too.
    """

    blob: str
    media_type: str
    width_px: int
    height_px: int
    meters_per_pixel: float
    origin_px: tuple[float, float]
    tiles: PlanTiles | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Floor:
    """One floor of a venue, with the world heights that it spans.

    `plan_from_world` is (4, 4), or None while it is not known how the plan lies in the world. `features_sha256` is the
    digest of the floor's features, None when it has none.
    """

    venue_id: str
    id: str
    name: str
    level: int
    z_min_m: float
    z_max_m: float
    plan_from_world: NDArray[np.float64] | None
    plan_residual_m: float | None
    plan: PlanImage | None
    features_sha256: str | None
