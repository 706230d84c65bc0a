"""Sessions whose phones agreed to be shown to those who run the venue: where they are, and where they were lost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, select

from app.storage.db import as_utc, now
from app.storage.sessions import SessionPoint, list_points
from app.storage.tables import sessions


@dataclass(frozen=True, slots=True)
class LostPlace:
    """The last place on a plan before frames could not be located, and the number of these frames."""

    floor: str
    x: float
    y: float
    frames: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedSession:
    """A session that is shown; `last` is its newest point, `place` its newest point on a plan."""

    id: str
    active_at: datetime
    last: SessionPoint | None
    place: SessionPoint | None
    lost: tuple[LostPlace, ...]


def list_shared(
    connection: Connection, venue_id: str, active_since: datetime, points: int
) -> Sequence[SharedSession]:
    """Return the sessions of a venue that may be shown, newest first; their last `points` points are looked at."""
    query = (
        select(sessions.c.id, sessions.c.active_at)
        .where(sessions.c.venue_id == venue_id, sessions.c.share, sessions.c.active_at >= active_since)
        .order_by(sessions.c.active_at.desc())
    )
    found = connection.execute(query).all()
    return [_shared(connection, row.id, as_utc(row.active_at) or now(), points) for row in found]


def lost_places(points: Iterable[SessionPoint]) -> tuple[LostPlace, ...]:
    """Return where a trajectory, oldest point first, was lost; frames before the first place don't count."""
    found: list[LostPlace] = []
    before: SessionPoint | None = None
    missed = 0
    for point in [*points, None]:
        if point is not None and point.plan is None:
            missed += 1
            continue
        if missed and before is not None and before.plan is not None:
            found.append(LostPlace(before.floor or "", before.plan[0], before.plan[1], missed))
        before, missed = point, 0
    return tuple(found)


def _shared(connection: Connection, session_id: str, active_at: datetime, count: int) -> SharedSession:
    points = list_points(connection, session_id, count)
    places = [point for point in points if point.plan is not None]
    return SharedSession(
        id=session_id,
        active_at=active_at,
        last=points[-1] if points else None,
        place=places[-1] if places else None,
        lost=lost_places(points),
    )
