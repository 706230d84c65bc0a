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
    },
}


class PlanImage(BaseModel):
    """A floor's plan image; GET of the plan returns it."""

    media_type: str
    width_px: int
    height_px: int
    meters_per_pixel: float
    origin_px: list[float] = Field(description="u, v of plan (0, 0) in the image")


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
