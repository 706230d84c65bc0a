"""A request of the OSCP GeoPose protocol, version 1 or 2: what is read of it.

Source: the repository OpenArCloud/oscp-geopose-protocol, the pages of version 1 and of version 2. The versions differ
in where sensor readings and camera parameters stand. Members that are not read are left alone: clients send many.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.oscp.response import GeoPoseResponse

# A JPEG's first bytes as base64, so that the example is short.
SHORT_PICTURE = "/9j/4AAQSkZJRg=="
REQUEST: dict[str, Any] = {
    "id": "9a3c1c1e-0f4e-4f0e-8d0c-2f5f1a2b3c4d",
    "timestamp": 1772355600000,
    "type": "geopose",
    "sensors": [{"id": "camera", "type": "camera"}, {"id": "gnss", "type": "geolocation"}],
    "sensorReadings": {
        "cameraReadings": [
            {
                "sensorId": "camera",
                "timestamp": 1772355600000,
                "imageFormat": "JPG",
                "size": [1280, 720],
                "imageBytes": SHORT_PICTURE,
                "params": {"model": "PINHOLE", "modelParams": [996.0, 996.0, 639.5, 359.5]},
            }
        ],
        "geolocationReadings": [
            {"sensorId": "gnss", "latitude": 47.3783, "longitude": 8.5403, "accuracy": 25.0}
        ],
    },
    "priorPoses": [],
}

# A request without a picture is refused in words of its own; the schema says that it holds one.
ONE_PICTURE: dict[str, Any] = {
    "contains": {
        "type": "object",
        "properties": {
            "reading": {
                "type": "object",
                "properties": {"imageBytes": {"type": "string"}},
                "required": ["imageBytes"],
            }
        },
        "required": ["reading"],
    }
}


def _needs_picture(schema: dict[str, Any]) -> None:
    """Say in a schema of version 2 that there is a camera reading."""
    schema["required"] = ["cameraReadings"]
    listed = schema["properties"]["cameraReadings"]
    schema["properties"]["cameraReadings"] = {
        **listed.pop("anyOf")[0],
        "title": listed["title"],
        "minItems": 1,
    }


Degrees = Annotated[float, Field(allow_inf_nan=False)]
# The protocol says milliseconds since 1970; clients of version 1 send ISO 8601 too.
Timestamp = int | float | str | None


class CameraParameters(BaseModel):
    """Intrinsics by COLMAP's names."""

    model_config = ConfigDict(protected_namespaces=())

    model: str | None = Field(None, description="PINHOLE, OPENCV, ...; unknown where it is left out")
    modelParams: list[float] | None = Field(None, description="In COLMAP's order")


class ImageOrientation(BaseModel):
    """How the sensor lies in the device."""

    mirrored: bool = Field(
        False, description="A mirrored picture can't be located", json_schema_extra={"const": False}
    )
    rotation: float = Field(0.0, description="Not used: the pose is that of the picture as it is sent")


class Picture(BaseModel):
    """What a camera saw."""

    imageFormat: str = Field(
        "", description="RGBA32, GRAY8: pixels, or a picture file; all else: a picture file"
    )
    size: list[int] | None = Field(None, max_length=2, description="Width and height in pixels")
    imageBytes: str = Field(description="base64")
    imageOrientation: ImageOrientation | None = None


class Geolocation(BaseModel):
    """Where the device is, roughly."""

    latitude: Degrees = Field(ge=-90, le=90)
    longitude: Degrees = Field(ge=-180, le=180)
    accuracy: float | None = Field(None, description="Metres; 0 where it is not known")


class OtherReading(BaseModel):
    """A reading of a sensor that is not used."""


class CameraReading(Picture):
    """A picture of version 2."""

    sensorId: str = ""
    timestamp: Timestamp = None
    params: CameraParameters | None = None


class GeolocationReading(Geolocation):
    """A rough position of version 2."""

    sensorId: str = ""
    timestamp: Timestamp = None


class SensorReadings(BaseModel):
    """The readings of version 2, by kind."""

    model_config = ConfigDict(json_schema_extra=_needs_picture)

    cameraReadings: list[CameraReading] | None = None
    geolocationReadings: list[GeolocationReading] | None = None


class SensorReading(BaseModel):
    """A reading of version 1."""

    sensorId: str = ""
    timestamp: Timestamp = None
    reading: Annotated[Picture | Geolocation | OtherReading | None, Field(union_mode="left_to_right")] = None


class Sensor(BaseModel):
    """A sensor; in version 1 it holds the camera's parameters."""

    id: str
    type: str
    params: CameraParameters | None = None


class GeoPoseRequest(BaseModel):
    """A request of the GeoPose protocol: version 1 has a list of sensor readings, version 2 an object."""

    model_config = ConfigDict(json_schema_extra={"example": REQUEST})

    id: str = Field(max_length=200)
    timestamp: Timestamp = None
    type: str = "geopose"
    sensors: list[Sensor] = []
    sensorReadings: SensorReadings | Annotated[list[SensorReading], Field(json_schema_extra=ONE_PICTURE)]
    priorPoses: list[GeoPoseResponse] | None = None

    @property
    def version(self) -> int:
        """The version of the protocol."""
        return 1 if isinstance(self.sensorReadings, list) else 2

    def picture(self) -> tuple[Picture, CameraParameters | None] | None:
        """Return the last picture with the parameters of its camera, None without one."""
        readings = self.sensorReadings
        if isinstance(readings, SensorReadings):
            pictures = readings.cameraReadings or []
            return (pictures[-1], pictures[-1].params) if pictures else None
        for reading in reversed(readings):
            if isinstance(reading.reading, Picture):
                params = [sensor.params for sensor in self.sensors if sensor.id == reading.sensorId]
                return reading.reading, params[0] if params else None
        return None

    def geolocation(self) -> Geolocation | None:
        """Return the last rough position, else that of the last prior pose, None without both."""
        readings = self.sensorReadings
        if isinstance(readings, SensorReadings):
            found: list[Geolocation] = list(readings.geolocationReadings or [])
        else:
            found = [each.reading for each in readings if isinstance(each.reading, Geolocation)]
        if found:
            return found[-1]
        if not self.priorPoses:
            return None
        position = self.priorPoses[-1].geopose.position
        return Geolocation(latitude=position.lat, longitude=position.lon, accuracy=None)
