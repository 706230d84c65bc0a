"""Where on Earth a venue lies and a camera is: origins, and GeoPoses of OGC 21-056r11."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import ID_PATTERN
from app.api.requests.fields import FIELDS
from app.api.requests.json_body import RequestBody
from app.api.schemas import Quaternion
from app.engine.floors.earth import VenueOrigin
from app.geometry.geopose import GeoPose

# A micrometre in degrees of latitude, and in metres.
DEGREE_DECIMALS = 11
HEIGHT_DECIMALS = 6
ANGLE_DECIMALS = 6

ORIGIN: dict[str, Any] = {
    "latitude": 47.3782,
    "longitude": 8.5402,
    "height_m": 455.2,
    "heading_deg": 35.0,
    "floor": None,
}
GEOPOSE: dict[str, Any] = {
    "position": {"lat": 47.37824976204, "lon": 8.54049157996, "h": 456.87004},
    "quaternion": {"x": 0.05732139, "y": -0.05358785, "z": -0.68934443, "w": 0.72017141},
    "angles": {"yaw": -87.485898, "pitch": 0.105624, "roll": 9.000536},
}


class OriginBody(RequestBody):
    """Where plan (0, 0) of a floor lies on Earth (WGS 84), and how the plan is turned."""

    model_config = ConfigDict(json_schema_extra={"example": ORIGIN})

    latitude: float = Field(
        ge=-FIELDS.max_latitude_deg,
        le=FIELDS.max_latitude_deg,
        strict=True,
        allow_inf_nan=False,
        description="Degrees, north is positive",
    )
    longitude: float = Field(
        ge=-180, le=180, strict=True, allow_inf_nan=False, description="Degrees, east is positive"
    )
    height_m: float = Field(
        ge=FIELDS.min_height_m,
        le=FIELDS.max_height_m,
        strict=True,
        allow_inf_nan=False,
        description="Above the ellipsoid, of height 0 of the plan (not above the sea)",
    )
    heading_deg: float = Field(
        ge=-360,
        le=360,
        strict=True,
        allow_inf_nan=False,
        description="Compass bearing of plan y, which is up on the drawing: degrees clockwise from true north",
    )
    floor: str | None = Field(
        None, pattern=ID_PATTERN, description="The floor whose plan is meant; the lowest if it is left out"
    )

    @staticmethod
    def of(origin: VenueOrigin) -> OriginBody:
        """Return the body of an origin."""
        return OriginBody(
            latitude=origin.latitude,
            longitude=origin.longitude,
            height_m=origin.height_m,
            heading_deg=origin.heading_deg,
            floor=origin.floor,
        )

    def to_origin(self) -> VenueOrigin:
        """Return the origin that a request states."""
        return VenueOrigin(
            latitude=self.latitude,
            longitude=self.longitude,
            height_m=self.height_m,
            heading_deg=self.heading_deg,
            floor=self.floor,
        )


class GeoPosition(BaseModel):
    """A position in WGS 84: degrees, and metres above the ellipsoid."""

    lat: float
    lon: float
    h: float


class YawPitchRoll(BaseModel):
    """Degrees: yaw counter-clockwise from east, pitch downwards, roll to the right; turns about z, y, x in turn."""

    yaw: float
    pitch: float
    roll: float


class GeoPoseBody(BaseModel):
    """A GeoPose 1.0, Basic-Quaternion (position, quaternion) and Basic-YPR (position, angles) in one.

    The orientation is that of the camera's body (x forward along the optical axis, y left, z up) against east, north
    and up at its position.
    """

    model_config = ConfigDict(json_schema_extra={"example": GEOPOSE})

    position: GeoPosition
    quaternion: Quaternion
    angles: YawPitchRoll

    @staticmethod
    def of(geopose: GeoPose) -> GeoPoseBody:
        """Return the body of a GeoPose, to the micrometre."""
        x, y, z, w = (round(float(value), 8) for value in geopose.quaternion)
        yaw, pitch, roll = (round(value, ANGLE_DECIMALS) for value in geopose.yaw_pitch_roll_deg)
        return GeoPoseBody(
            position=GeoPosition(
                lat=round(geopose.latitude, DEGREE_DECIMALS),
                lon=round(geopose.longitude, DEGREE_DECIMALS),
                h=round(geopose.height_m, HEIGHT_DECIMALS),
            ),
            quaternion=Quaternion(x=x, y=y, z=z, w=w),
            angles=YawPitchRoll(yaw=yaw, pitch=pitch, roll=roll),
        )
