"""The audit log, to read."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import CallerOf, State, require
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.limits import limit
from app.storage.audit import AuditEntry, list_acts

router = APIRouter(
    prefix="/audit", tags=["keys"], dependencies=[Depends(require("admin"))], route_class=ContractRoute
)


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditOptions:
    """How much of the log an answer holds."""

    default_entries: int = limit(
        100, "Entries of an answer for which no number is asked.", chosen="By hand: a screen or two."
    )
    max_entries: int = limit(
        1000, "Largest number of entries of an answer.", chosen="By hand: some hundred kilobytes."
    )


OPTIONS = AuditOptions()


class AuditEntryBody(BaseModel):
    """One act: which key made which call to what, when, and from where."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": 17,
                "at": "2026-03-01T09:00:00Z",
                "key": "3f0c52a91b7de604",
                "key_name": "Operator",
                "act": "DELETE /venues/{venue}",
                "target": "/venues/old",
                "venue": "old",
                "address": "192.0.2.7",
            }
        }
    )

    id: int = Field(description="Grows with time")
    at: datetime
    key: str | None = Field(description="The key's id; null for ROOMFIX_ADMIN_KEY and the command line")
    key_name: str
    act: str = Field(
        description="Method and route, as in this description", examples=["DELETE /venues/{venue}"]
    )
    target: str = Field(description="The path that was called")
    venue: str | None
    address: str | None

    @staticmethod
    def of(entry: AuditEntry) -> AuditEntryBody:
        """Return the body of an entry."""
        act = entry.act
        return AuditEntryBody(
            id=entry.id,
            at=entry.at,
            key=act.key_id,
            key_name=act.key_name,
            act=act.act,
            target=act.target,
            venue=act.venue_id,
            address=act.address,
        )


@router.get("", name="listAudit", responses=problems(401, 422))
def list_all(
    state: State,
    caller: CallerOf,
    limit: Annotated[int, Query(ge=1, le=OPTIONS.max_entries, description="Number of entries")] = (
        OPTIONS.default_entries
    ),
    before: Annotated[
        int | None, Query(ge=1, le=2**31 - 1, description="Only entries older than that of this id")
    ] = None,
) -> list[AuditEntryBody]:
    """List what administrators changed, newest first; a key limited to a venue sees that venue's."""
    with state.services.resources.database.read() as connection:
        return [AuditEntryBody.of(entry) for entry in list_acts(connection, caller.venue_id, before, limit)]
