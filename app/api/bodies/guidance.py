"""What a walker is told, in the answers of a session that has a destination."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.engine.navigation.model import Turn


class SessionGuidance(BaseModel):
    """What a walker does next. Which fields there are depends on `problem`: with one, only those that it explains."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "instruction": "Turn left at the lobby.",
                "turn": "left",
                "distance_m": 3.2,
                "remaining_m": 24.5,
                "off_route": False,
                "arrived": False,
                "landmark": "lobby",
                "along_m": 11.0,
                "bearing_deg": 12.5,
                "planned": False,
                "problem": None,
            }
        }
    )

    instruction: str | None = Field(None, description="A sentence in the session's language")
    turn: Turn | None = Field(None, description="Of the next step")
    distance_m: float | None = Field(None, description="To the next step, along the route")
    remaining_m: float | None = Field(None, description="To the destination, along the route")
    off_route: bool | None = None
    arrived: bool | None = None
    landmark: str | None = Field(None, description="Of the next step")
    along_m: float | None = Field(None, description="From the start, along the route")
    bearing_deg: float | None = Field(
        None, description="Direction of the way ahead, counter-clockwise from where the walker faces"
    )
    planned: bool | None = Field(None, description="Whether the route was planned anew for this frame")
    problem: Literal["lost", "no_route", "off_network"] | None = Field(
        None, description="Why there is no guidance"
    )
    detail: str | None = Field(None, description="The problem in a sentence")
    go_on_m: float | None = Field(
        None, description="While lost: how far to go on as told before; null to stand still"
    )
