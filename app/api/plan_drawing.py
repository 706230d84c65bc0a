"""A floor's plan with its features, and a route over it, as a picture."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response

from app.api.deps import FloorId, State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.requests.fields import FIELDS
from app.api.schemas import FILE_CONTENT, problems
from app.engine.navigation.plan_drawing import draw_plan
from app.errors import InvalidInputError
from app.storage.floors import get_floor

router = APIRouter(
    prefix="/venues/{venue}/floors/{floor}/plan.svg", tags=["floors"], route_class=ContractRoute
)
# Names come from clients: whatever one of them holds, the picture runs no script and fetches nothing.
HEADERS = {"Content-Security-Policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'"}


@router.get(
    "",
    name="drawPlan",
    dependencies=[Depends(require("locate"))],
    responses={200: {"content": {"image/svg+xml": FILE_CONTENT}}, **problems(401, 404, 422)},
    response_class=Response,
)
async def get(
    state: State,
    venue: VenueId,
    floor: FloorId,
    start: Annotated[str | None, Query(alias="from", max_length=FIELDS.max_place_characters)] = None,
    end: Annotated[str | None, Query(alias="to", max_length=FIELDS.max_place_characters)] = None,
) -> Response:
    """Return the plan image with areas, links and landmarks; with `from` and `to` the route between them too."""
    if (start is None) != (end is None):
        raise InvalidInputError("Give both from and to, or neither.")

    def draw() -> bytes:
        services = state.services
        with services.resources.database.read() as connection:
            found = get_floor(connection, venue, floor)
        route = None if start is None or end is None else services.routes.route(venue, start, end)
        image = None if found.plan is None else services.resources.blobs.get(found.plan.blob)
        return draw_plan(found, services.features.features(found), image, route).encode()

    return Response(await state.drawings.run(draw), media_type="image/svg+xml", headers=HEADERS)
