"""A floor as the API shows it."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

FLOOR: dict[str, Any] = {
    "venue": "museum",
    "id": "0",
    "name": "Ground floor",
    "level": 0,
    "z_min_m": -0.5,
    "z_max_m": 3.0,
    "plan_from_world": [
        [1.0, 0.0, 0.0, 2.0],
        [0.0, 1.0, 0.0, 1.5],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ],
    "plan_residual_m": 0.0,
    "plan": {
        "media_type": "image/png",
        "width_px": 1200,
        "height_px": 900,
        "meters_per_pixel": 0.02,
        "origin_px": [100.0, 820.0],
        "tiles": None,
    },
}


class PlanTiles(BaseModel):
    """Tiles of a plan of many pixels: zoom 0 is one tile, each further zoom has twice the pixels, `max_zoom` all."""

    width_px: int = Field(description="Of all pixels, at max_zoom")
    height_px: int
    tile_px: int = Field(description="Side of a tile; those at the right and lower edge are smaller")
    max_zoom: int
    reduced_by: int = Field(
        description="Pixels of max_zoom, along each side, in one of the plan's image; upper left corners agree"
    )


class PlanImage(BaseModel):
    """A floor's plan image; GET of the plan returns it."""

    media_type: str
    width_px: int
    height_px: int
    meters_per_pixel: float
    origin_px: list[float] = Field(description="u, v of plan (0, 0) in the image")
    tiles: PlanTiles | None = Field(description="Of a plan of more than 16 million pixels; null for others")


class Floor(BaseModel):
    """A floor and where its plan lies in the world."""

    model_config = ConfigDict(json_schema_extra={"example": FLOOR})

    venue: str
    id: str
    name: str
    level: int
    z_min_m: float
    z_max_m: float
    plan_from_world: list[list[float]] | None = Field(description="4x4; null while it is not known")
    plan_residual_m: float | None = Field(
        description="RMS error of the correspondences that it was fitted to"
    )
    plan: PlanImage | None


class StoredFloor(Floor):
    """A floor as it was stored, with the scale that the fit of its correspondences gave."""

    model_config = ConfigDict(json_schema_extra={"example": {**FLOOR, "plan_scale": 1.0}})

    plan_scale: float | None
