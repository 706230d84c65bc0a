"""A monitoring camera as the API shows it."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas import PoseBody


class StatedCamera(BaseModel):
    """A camera as it was stated: COLMAP's model, image size and parameters."""

    model: str
    width: int
    height: int
    params: list[float]


# A list is fx, fy, cx, cy and what distortion was given.
CameraAsStated = StatedCamera | list[float]


class AnchorPosition(BaseModel):
    """A point on the plan, in metres."""

    x: float
    y: float


class AnchorPoi(BaseModel):
    """A point of interest of a monitoring camera."""

    id: str
    region_px: list[list[float]] = Field(description="Corners [u, v] around it in the camera's frames")
    position: AnchorPosition
    distance_m: float
    height_m: float | None


class AnchorFrame(BaseModel):
    """The newest frame of a monitoring camera."""

    id: str
    received_at: datetime
    age_s: float
    fresh: bool = Field(description="Whether it is young enough to be used")
    features: int
    pois_visible: list[str]
    image_stored: bool


class CalibratedPlace(BaseModel):
    """Where a monitoring camera is on the plan by the map."""

    x: float
    y: float
    heading_deg: float


class CalibratedAccuracy(BaseModel):
    """One sigma."""

    position_m: float
    orientation_deg: float


class CalibratedPoi(BaseModel):
    """A POI's position by the map."""

    id: str
    position: AnchorPosition
    height_m: float
    distance_m: float


class AnchorCalibration(BaseModel):
    """What calibration found of the camera in the map."""

    map_version: int
    pose: PoseBody
    plan: CalibratedPlace
    height_m: float
    accuracy: CalibratedAccuracy
    inliers: int
    pois: list[CalibratedPoi] = Field(description="Those that the map has enough points of")
    calibrated_at: str


class Anchor(BaseModel):
    """A monitoring camera, its newest frame, and how often it has located a phone."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": "hall-camera",
                "venue": "museum",
                "floor": "0",
                "position": {"x": 4.2, "y": 11.0},
                "height_m": 2.6,
                "heading_deg": None,
                "camera": {"model": "PINHOLE", "width": 1280, "height": 720, "params": [910, 910, 640, 360]},
                "pois": [
                    {
                        "id": "exit-sign",
                        "region_px": [[560, 210], [720, 210], [720, 300], [560, 300]],
                        "position": {"x": 9.8, "y": 12.5},
                        "distance_m": 5.9,
                        "height_m": None,
                    }
                ],
                "store_images": False,
                "max_age_s": 60.0,
                "calibration": None,
                "uses": 0,
                "last_used_at": None,
                "frame": None,
            }
        }
    )

    id: str
    venue: str
    floor: str
    position: AnchorPosition
    height_m: float
    heading_deg: float | None
    camera: Annotated[CameraAsStated, Field(description="As it was stated")]
    pois: list[AnchorPoi]
    store_images: bool
    max_age_s: float
    calibration: AnchorCalibration | None
    uses: int
    last_used_at: datetime | None
    frame: AnchorFrame | None
