"""Guidance of a session towards its destination: the one place where routes meet tracking."""

from __future__ import annotations

from typing import Any

from app.services.floor_plans import PlanPoint
from app.storage.floors import Floor


def guidance_for(
    _destination: str | None, _language: str | None, _floor: Floor | None, _plan: PlanPoint | None
) -> dict[str, Any] | None:
    """Return the guidance from a point on a floor's plan to a destination, None without either.

    Venues have no routes so far, so there is none to give.
    """
    return None
