"""The features of a floor: landmarks, points of interest, areas and links, as GeoJSON."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from app.api.deps import FloorId, State, VenueId, require
from app.api.schemas import problems
from app.services.floor_features.store import store_features, stored_features

router = APIRouter(prefix="/venues/{venue}/floors/{floor}/features", tags=["floors"])
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
    """What a floor's features are now: how many of each kind."""

    venue: str
    floor: str
    counts: dict[str, int]


@router.put(
    "",
    dependencies=[Depends(require("admin"))],
    responses=problems(401, 404, 413, 422),
    openapi_extra=BODY,
)
async def put(state: State, venue: VenueId, floor: FloorId, request: Request) -> FeaturesBody:
    """Replace a floor's features by a GeoJSON FeatureCollection."""
    data = await request.body()
    features = await run_in_threadpool(store_features, state.resources, venue, floor, data)
    return FeaturesBody(venue=venue, floor=floor, counts={**features.counts})


@router.get(
    "",
    dependencies=[Depends(require("locate"))],
    responses={200: {"content": {MEDIA_TYPE: {}}}, **problems(401, 404, 422)},
    response_class=JSONResponse,
)
def get(state: State, venue: VenueId, floor: FloorId) -> Any:
    """Return a floor's features in plan metres, in the form that PUT takes."""
    return JSONResponse(stored_features(state.resources, venue, floor), media_type=MEDIA_TYPE)
