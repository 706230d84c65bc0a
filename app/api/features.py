"""The features of a floor: landmarks, points of interest, areas and links, as GeoJSON."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from app.api.deps import FloorId, State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.engine.navigation.network import unmet_links
from app.services.floor_features import store_features, stored_features

router = APIRouter(
    prefix="/venues/{venue}/floors/{floor}/features", tags=["floors"], route_class=ContractRoute
)
MEDIA_TYPE = "application/geo+json"
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
BODY = {
    "requestBody": {
        "required": True,
        "content": {
            MEDIA_TYPE: {"schema": {"type": "object"}, "example": EXAMPLE},
            "application/json": {"schema": {"type": "object"}, "example": EXAMPLE},
        },
    }
}


class FeaturesBody(BaseModel):
    """What a floor's features are now: how many of each kind, and what of the venue's links is not joined yet."""

    venue: str
    floor: str
    counts: dict[str, int]
    warnings: list[str] = Field(description="Links between floors that meet nothing where they lead to")


@router.put(
    "",
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 413, 422),
    openapi_extra=BODY,
)
async def put(state: State, venue: VenueId, floor: FloorId, request: Request) -> FeaturesBody:
    """Replace a floor's features by a GeoJSON FeatureCollection."""
    data = await request.body()

    def store() -> FeaturesBody:
        features = store_features(state.services.resources, venue, floor, data)
        warnings = unmet_links(state.services.routes.network(venue))
        return FeaturesBody(venue=venue, floor=floor, counts={**features.counts}, warnings=warnings)

    return await run_in_threadpool(store)


@router.get(
    "",
    dependencies=[Depends(require("locate"))],
    responses={200: {"content": {MEDIA_TYPE: {}}}, **problems(401, 404, 422)},
    response_class=JSONResponse,
)
def get(state: State, venue: VenueId, floor: FloorId) -> Any:
    """Return a floor's features in plan metres, in the form that PUT takes."""
    return JSONResponse(stored_features(state.services.resources, venue, floor), media_type=MEDIA_TYPE)
