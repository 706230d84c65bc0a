"""What a build reports of its map; the statistics of a map version are the same."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class OpenBody(BaseModel):
    """An object that may hold more than its model names: what builds report grows."""

    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, Any] = Field(init=False)


class Placement(OpenBody):
    """How the scan was brought into the venue's world."""

    source: str = Field(description="given, gravity, registered or scan_frame")
    z_up: bool = Field(False, description="Whether the world's z is known to point up")
    has_scale: bool = Field(True, description="Whether the map is in metres, or in a unit of its own")


class SelfCheckFigures(OpenBody):
    """Frames of the scan that were located in the map before it was published."""

    tried: int
    located: int
    expected: int | None = None
    median_position_m: float | None = None
    median_orientation_deg: float | None = None


class BuildReport(OpenBody):
    """What became of a scan. A map of an older server may lack some of the fields."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "example": {
                "warnings": [],
                "frames": 2400,
                "discarded": {"blurred": 74},
                "keyframes": 2236,
                "features": 914228,
                "feature_method": "sift",
                "map_keyframes": 2236,
                "bytes": {"features": 144650560, "index": 36634669},
                "seconds": {"describe": 87.9, "refine": 38.9},
                "world_from_scan": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
                "placement": {"source": "given", "z_up": True},
                "self_check": {"tried": 24, "expected": 20, "located": 11, "median_position_m": 0.00095},
            }
        },
    )

    warnings: list[str] = []
    frames: int | None = Field(None, description="Frames of the scan")
    discarded: dict[str, int] = Field({}, description="Number of frames left out, by reason")
    discarded_frames: dict[str, list[str]] = Field({}, description="The first of them by name")
    notes: list[str] = []
    replaced: dict[str, Any] = {}
    keyframes: int | None = Field(None, description="Keyframes of this scan")
    features: int | None = None
    feature_method: str | None = None
    map_keyframes: int | None = Field(None, description="Keyframes of the whole map")
    bytes: dict[str, int] = Field({}, description="Size of the map's files")
    seconds: dict[str, float] = Field({}, description="Time by stage")
    world_from_scan: list[list[float]] | None = Field(None, description="The 4x4 that was used")
    placement: Placement | None = None
    examination: dict[str, Any] | None = Field(
        None, description="What was found to be right or wrong in the scan"
    )
    structure: dict[str, Any] | None = Field(
        None, description="How poses were estimated from pictures that had none: camera, scale, up, parts"
    )
    self_check: SelfCheckFigures | None = None
    lens: dict[str, float] | None = None
    calibration: dict[str, Any] | None = None
