"""Routes over a venue's floors, with what to say at each step."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query
from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.requests.fields import FIELDS
from app.api.schemas import problems
from app.engine.floors.model import LinkMode
from app.engine.floors.reading import MODE_WORDS
from app.engine.floors.sentences import short
from app.engine.navigation.language import Speaker, language_of
from app.engine.navigation.model import Route, Step, Turn
from app.engine.navigation.places import Place
from app.engine.navigation.search import Limits
from app.errors import InvalidInputError

router = APIRouter(
    prefix="/venues/{venue}/route",
    tags=["routes"],
    dependencies=[Depends(require("locate"))],
    route_class=ContractRoute,
)
SESSION_PREFIX = "session:"
AVOIDABLE: tuple[LinkMode, ...] = ("stairs", "lift", "escalator")


class RoutePointBody(BaseModel):
    """A point of the route's line: plan metres on a floor."""

    floor: str
    x: float
    y: float


class StepBody(BaseModel):
    """What to do at a point; `distance_m` leads from there to the next step."""

    instruction: str
    turn: Turn
    distance_m: float
    landmark: str | None = Field(description="Id of the landmark where this is, else of the one it leads to")
    landmark_name: str | None
    passing: list[str] = Field(description="Ids of landmarks on the way to the next step")
    mode: LinkMode
    floor: str
    to_floor: str | None
    x: float
    y: float


STEP: dict[str, Any] = {
    "instruction": "Go straight on for 12 m to the lobby.",
    "turn": "depart",
    "distance_m": 12.5,
    "landmark": "lobby",
    "landmark_name": "Lobby",
    "passing": [],
    "mode": "walk",
    "floor": "0",
    "to_floor": None,
    "x": 0.0,
    "y": 0.0,
}


class RouteBody(BaseModel):
    """A route; its steps' distances add up to `distance_m`."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "venue": "museum",
                "language": "en",
                "distance_m": 12.5,
                "landmarks": ["entrance", "lobby"],
                "path": [{"floor": "0", "x": 0.0, "y": 0.0}, {"floor": "0", "x": 12.5, "y": 0.0}],
                "steps": [STEP],
            }
        }
    )

    venue: str
    language: str
    distance_m: float
    landmarks: list[str] = Field(description="Ids of the landmarks on or beside the way, in its order")
    path: list[RoutePointBody]
    steps: list[StepBody]


@router.get("", name="findRoute", responses=problems(401, 404, 409, 422))
def get(
    state: State,
    venue: VenueId,
    start: Annotated[
        str,
        Query(
            alias="from",
            max_length=FIELDS.max_place_characters,
            description="A landmark's id, floor:x,y, or session:ID",
        ),
    ],
    end: Annotated[
        str,
        Query(
            alias="to", max_length=FIELDS.max_place_characters, description="A landmark's id, or floor:x,y"
        ),
    ],
    avoid: Annotated[
        list[str] | None,
        Query(max_length=FIELDS.max_avoided, description="stairs, lift, escalator; repeated or with commas"),
    ] = None,
    accessible: Annotated[bool, Query(description="Use accessible links only")] = False,
    heading_deg: Annotated[
        float | None,
        Query(
            allow_inf_nan=False,
            ge=-FIELDS.max_heading_deg,
            le=FIELDS.max_heading_deg,
            description="Where the walker looks, from plan x to the left",
        ),
    ] = None,
    language: Annotated[
        str | None,
        Query(max_length=FIELDS.max_language_characters, description="en or de; else by Accept-Language"),
    ] = None,
    accept_language: Annotated[str | None, Header()] = None,
) -> RouteBody:
    """Return the shortest route from one place to another."""
    spoken = language_of(language, accept_language)
    limits = Limits(_modes(avoid or []), accessible)
    origin: str | Place = start
    if start.startswith(SESSION_PREFIX):
        origin = state.services.sessions.place(start.removeprefix(SESSION_PREFIX), venue)
    return body_of(venue, state.services.routes.route(venue, origin, end, limits, heading_deg), spoken)


def body_of(venue: str, route: Route, language: str) -> RouteBody:
    """Return the body of a route."""
    speaker = Speaker(language, route.floor_names)
    return RouteBody(
        venue=venue,
        language=language,
        distance_m=round(route.distance_m, 2),
        landmarks=[passage.landmark.id for passage in route.passages],
        path=[RoutePointBody(floor=p.floor, x=round(p.x, 3), y=round(p.y, 3)) for p in route.points],
        steps=[_step_body(step, speaker) for step in route.steps],
    )


def _step_body(step: Step, speaker: Speaker) -> StepBody:
    landmark = step.at or step.towards
    return StepBody(
        instruction=speaker.step(step),
        turn=step.turn,
        distance_m=round(step.distance_m, 2),
        landmark=landmark and landmark.id,
        landmark_name=landmark and landmark.name,
        passing=[mark.id for mark in step.passing],
        mode=step.mode,
        floor=step.floor,
        to_floor=step.to_floor,
        x=round(step.x, 3),
        y=round(step.y, 3),
    )


def _modes(values: list[str]) -> frozenset[LinkMode]:
    given = [word.strip().lower() for value in values for word in value.split(",") if word.strip()]
    words = [MODE_WORDS.get(word, word) for word in given]
    unknown = [word for word in words if word not in AVOIDABLE]
    if unknown:
        raise InvalidInputError(
            f"avoid must name {', '.join(AVOIDABLE)}, with commas between them, not {short(unknown[0])}."
        )
    return frozenset(mode for mode in AVOIDABLE if mode in words)
