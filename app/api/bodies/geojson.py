"""The features of a floor as GeoJSON, to describe them: a parser of the engine reads and checks them."""

from __future__ import annotations

from typing import Any, Literal

from fastapi.responses import JSONResponse
from geojson_pydantic import Feature, FeatureCollection, LineString, Point, Polygon
from pydantic import BaseModel, ConfigDict, Field

from app.engine.floors.model import Kind, LinkMode

MEDIA_TYPE = "application/geo+json"


class GeoJsonResponse(JSONResponse):
    """An answer that is GeoJSON."""

    media_type = MEDIA_TYPE


class FeatureProperties(BaseModel):
    """What a feature is; further properties are kept."""

    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, Any] = Field(init=False)

    kind: Kind
    name: str | None = Field(None, description="Of a landmark, POI or area")
    category: str | None = Field(None, description="Of an area")
    mode: LinkMode | None = Field(None, description="Of a link")
    accessible: bool | None = Field(None, description="Of a link")
    one_way: bool | None = Field(None, description="Of a link")
    to_floor: str | None = Field(None, description="Of a link between floors")


class FloorFeature(Feature[Point | Polygon | LineString, FeatureProperties]):
    """A landmark or POI (Point), an area (Polygon) or a link (LineString), in plan metres."""

    geometry: Point | Polygon | LineString
    properties: FeatureProperties


class FloorFeatureCollection(FeatureCollection[FloorFeature]):
    """The features of a floor."""


class PlacedProperties(BaseModel):
    """What a feature of a venue is, and on which floor; further properties are those of the floor's features."""

    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, Any] = Field(init=False)

    kind: Kind | Literal["plan"]
    floor: str
    level: int
    corners: list[list[float]] | None = Field(
        None,
        description="Of a plan: longitude and latitude of the image's corners, clockwise from its upper left",
    )


class PlacedFeature(Feature[Point | Polygon | LineString, PlacedProperties]):
    """A plan's outline (Polygon), or a feature of a floor, in longitude and latitude."""


class VenueFeatureCollection(FeatureCollection[PlacedFeature]):
    """The plans and features of a venue."""


EXAMPLE = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": "lobby",
            "geometry": {"type": "Point", "coordinates": [2.0, 3.0]},
            "properties": {"kind": "landmark", "name": "Lobby"},
        }
    ],
}
VENUE_EXAMPLE = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": "lobby",
            "geometry": {"type": "Point", "coordinates": [8.5402445239, 47.3782117739]},
            "properties": {"kind": "landmark", "name": "Lobby", "floor": "0", "level": 0},
        }
    ],
}
