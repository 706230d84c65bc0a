"""The features of a floor: landmarks, points of interest, areas and links, as GeoJSON."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field

from app.api.bodies.geojson import EXAMPLE, MEDIA_TYPE, FloorFeatureCollection, GeoJsonResponse
from app.api.deps import FloorId, State, VenueId, require
from app.api.requests.conditional import NOT_MODIFIED, unless_known
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.engine.navigation.network import unmet_links
from app.services.floor_features import store_features
from app.services.plans.earth_geojson import digest_of, floor_geojson
from app.storage.floors import get_features

router = APIRouter(
    prefix="/venues/{venue}/floors/{floor}/features", tags=["floors"], route_class=ContractRoute
)
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
    responses={
        200: {"content": {MEDIA_TYPE: {"schema": SCHEMA}}},
        **NOT_MODIFIED,
        **problems(401, 404, 409, 422),
    },
    response_model=FloorFeatureCollection,
    response_class=GeoJsonResponse,
)
def get(
    state: State,
    venue: VenueId,
    floor: FloorId,
    request: Request,
    crs: Annotated[
        Literal["plan", "wgs84"],
        Query(description="Plan metres, or longitude and latitude where the venue has an origin"),
    ] = "plan",
) -> Any:
    """Return a floor's features in plan metres or in longitude and latitude, in a form that PUT takes."""
    if crs == "wgs84":
        on_earth = floor_geojson(state.services.resources, venue, floor)
        return unless_known(request, digest_of(on_earth), lambda: GeoJsonResponse(on_earth))
    with state.services.resources.database.read() as connection:
        found = get_features(connection, venue, floor)
    return unless_known(request, found.sha256 or "none", lambda: GeoJsonResponse(found.collection))
