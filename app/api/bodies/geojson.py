"""The features of a floor as GeoJSON, to describe them: a parser of the engine reads and checks them."""

from __future__ import annotations

from typing import Any

from geojson_pydantic import Feature, FeatureCollection, LineString, Point, Polygon
from pydantic import BaseModel, ConfigDict, Field

from app.engine.floors.model import Kind, LinkMode


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
