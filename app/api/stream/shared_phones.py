"""Phones in a venue that agreed to be shown: for those who run it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import State, VenueId, require
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.api.sessions import POINT, TrackingState, TrajectoryPoint
from app.limits import limit
from app.storage.db import now
from app.storage.shared_sessions import SharedSession, list_shared
from app.storage.venues import get_venue

router = APIRouter(
    prefix="/venues/{venue}/phones",
    tags=["sessions"],
    dependencies=[Depends(require("admin"))],
    route_class=ContractRoute,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedOptions:
    """How much of shared sessions is shown."""

    points: int = limit(
        2000, "Newest points of a session that are looked at.", chosen="By hand: some minutes of a walk."
    )


OPTIONS = SharedOptions()


class LostPlaceBody(BaseModel):
    """Where frames could not be located: the last place on the plan before, and how many frames it were."""

    floor: str
    x: float
    y: float
    frames: int


EXAMPLE: dict[str, Any] = {
    "phone": "4d0f6a1b",
    "active_at": "2026-03-01T09:00:01Z",
    "tracking": "lost",
    "place": {**POINT, "pose": None},
    "lost": [{"floor": "0", "x": 14.865, "y": 17.163, "frames": 8}],
}


class SharedPhone(BaseModel):
    """A phone that agreed to be shown."""

    model_config = ConfigDict(json_schema_extra={"example": EXAMPLE})

    phone: str = Field(description="Distinguishes phones; no address of the session")
    active_at: datetime
    tracking: TrackingState
    place: TrajectoryPoint | None = Field(description="Its newest place on a plan")
    lost: list[LostPlaceBody]

    @staticmethod
    def of(session: SharedSession) -> SharedPhone:
        """Return the body of a session."""
        return SharedPhone(
            phone=session.id[:8],
            active_at=session.active_at,
            tracking="initializing" if session.last is None else session.last.tracking,
            place=None if session.place is None else TrajectoryPoint.of(session.place),
            lost=[
                LostPlaceBody(floor=place.floor, x=place.x, y=place.y, frames=place.frames)
                for place in session.lost
            ],
        )


@router.get("", name="listSharedPhones", responses=problems(401, 404, 422))
def list_all(state: State, venue: VenueId) -> list[SharedPhone]:
    """List the phones that agreed to be shown, newest first: where they are, and where they were lost.

    A session agrees by `share`, and is shown until it expires or takes that back.
    """
    settings = state.services.resources.settings
    since = now() - timedelta(seconds=settings.session_timeout_s)
    with state.services.resources.database.read() as connection:
        get_venue(connection, venue)
        return [SharedPhone.of(each) for each in list_shared(connection, venue, since, OPTIONS.points)]
