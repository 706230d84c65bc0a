"""The features of a floor: landmarks, points of interest, areas and links, as GeoJSON."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field

from app.api.bodies.geojson import EXAMPLE, FloorFeatureCollection
from app.api.deps import FloorId, State, VenueId, require
from app.api.requests.conditional import NOT_MODIFIED, unless_known
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.engine.navigation.network import unmet_links
from app.services.floor_features import store_features
from app.storage.floors import get_features

router = APIRouter(
    prefix="/venues/{venue}/floors/{floor}/features", tags=["floors"], route_class=ContractRoute
)
MEDIA_TYPE = "application/geo+json"
SCHEMA = {"$ref": "#/components/schemas/FloorFeatureCollection"}
BODY = {
    "requestBody": {
        "required": True,
        "content": {
            MEDIA_TYPE: {"schema": SCHEMA, "example": EXAMPLE},
            "application/json": {"schema": SCHEMA, "example": EXAMPLE},
        },
    }
}


class GeoJsonResponse(JSONResponse):
    """An answer that is GeoJSON."""

    media_type = MEDIA_TYPE


class StoredFeatures(BaseModel):
    """What a floor's features are now: how many of each kind, and what of the venue's links is not joined yet."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "venue": "museum",
                "floor": "0",
                "counts": {"landmark": 1, "poi": 0, "area": 0, "link": 0},
                "warnings": [],
            }
        }
    )

    venue: str
    floor: str
    counts: dict[str, int]
    warnings: list[str] = Field(description="Links between floors that meet nothing where they lead to")


@router.put(
    "",
    name="putFeatures",
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 413, 422),
    openapi_extra=BODY,
)
async def put(state: State, venue: VenueId, floor: FloorId, request: Request) -> StoredFeatures:
    """Replace a floor's features by a GeoJSON FeatureCollection."""
    data = await request.body()

    def store() -> StoredFeatures:
        features = store_features(state.services.resources, venue, floor, data)
        warnings = unmet_links(state.services.routes.network(venue))
        return StoredFeatures(venue=venue, floor=floor, counts={**features.counts}, warnings=warnings)

    return await run_in_threadpool(store)


@router.get(
    "",
    name="getFeatures",
    dependencies=[Depends(require("locate"))],
    responses={200: {"content": {MEDIA_TYPE: {"schema": SCHEMA}}}, **NOT_MODIFIED, **problems(401, 404, 422)},
    response_model=FloorFeatureCollection,
    response_class=GeoJsonResponse,
)
def get(state: State, venue: VenueId, floor: FloorId, request: Request) -> Any:
    """Return a floor's features in plan metres, in the form that PUT takes."""
    with state.services.resources.database.read() as connection:
        found = get_features(connection, venue, floor)
    return unless_known(request, found.sha256 or "none", lambda: GeoJsonResponse(found.collection))
