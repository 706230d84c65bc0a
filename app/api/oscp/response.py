"""A response of the OSCP GeoPose protocol: the same in both versions, and a prior pose of a request."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.bodies.earth import GEOPOSE, GeoPosition
from app.api.schemas import Quaternion

RESPONSE: dict[str, Any] = {
    "id": "9a3c1c1e-0f4e-4f0e-8d0c-2f5f1a2b3c4d",
    "timestamp": 1772355600412,
    "type": "geopose",
    "accuracy": {"position": 0.017, "orientation": 0.23},
    "geopose": {"position": GEOPOSE["position"], "quaternion": GEOPOSE["quaternion"]},
}


class GeoPoseAccuracy(BaseModel):
    """One sigma: metres and degrees."""

    position: float
    orientation: float


class BasicQuaternion(BaseModel):
    """A GeoPose 1.0 of the type Basic-Quaternion."""

    position: GeoPosition
    quaternion: Quaternion


class GeoPoseResponse(BaseModel):
    """Where on Earth the camera was."""

    model_config = ConfigDict(json_schema_extra={"example": RESPONSE})

    id: str = Field(description="That of the request")
    timestamp: int | float | str | None = Field(None, description="Of the answer: milliseconds since 1970")
    type: str = "geopose"
    accuracy: GeoPoseAccuracy | None = None
    geopose: BasicQuaternion
