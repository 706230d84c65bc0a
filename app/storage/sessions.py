"""Sessions: a camera that is tracked, the state of its tracker, and its trajectory."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, Row, bindparam, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from app.errors import ConflictError, NotFoundError
from app.storage.db import as_utc, now
from app.storage.tables import session_points, sessions


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """A session. `camera` is JSON; `memory` is the tracker's, empty before the first frame; `frames` is the number of
    answered frames."""

    id: str
    venue_id: str
    camera: dict[str, Any] | list[float] | None
    destination: str | None
    language: str | None
    memory: dict[str, Any]
    frames: int
    created_at: datetime
    active_at: datetime
    share: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPoint:
    """One frame of a trajectory. `pose` is world_from_camera as x y z qx qy qz qw, `plan` is x, y in metres and the
    heading in degrees; each is None when the frame was not located, `plan` also where there is no plan."""

    frame: int
    time_s: float
    tracking: str
    pose: list[float] | None
    floor: str | None
    plan: list[float] | None
    position_m: float | None


def create_session(
    connection: Connection,
    venue_id: str,
    camera: dict[str, Any] | list[float] | None,
    destination: str | None,
    language: str | None,
    *,
    share: bool = False,
) -> Session:
    """Add a session; raises `NotFoundError` for an unknown venue."""
    moment = now()
    session = Session(
        id=uuid.uuid4().hex,
        venue_id=venue_id,
        camera=camera,
        destination=destination,
        language=language,
        memory={},
        frames=0,
        created_at=moment,
        active_at=moment,
        share=share,
    )
    values = {name: getattr(session, name) for name in Session.__slots__}
    try:
        connection.execute(insert(sessions).values(**values))
    except IntegrityError:
        raise NotFoundError(f"There is no venue {venue_id!r}.") from None
    return session


def get_session(connection: Connection, session_id: str, timeout: timedelta) -> Session:
    """Return a session; raises `NotFoundError`, also for a session without a frame for longer than `timeout`."""
    row = connection.execute(select(sessions).where(sessions.c.id == session_id)).first()
    session = None if row is None else _session(row)
    if session is None or now() - session.active_at > timeout:
        raise _gone(session_id)
    return session


def change_session(connection: Connection, session_id: str, values: dict[str, Any]) -> None:
    """Change destination, language, camera or `share` of an existing session."""
    if values:
        connection.execute(update(sessions).where(sessions.c.id == session_id).values(**values))


def record_frame(
    connection: Connection,
    session: Session,
    camera: dict[str, Any] | list[float] | None,
    memory: dict[str, Any],
    point: SessionPoint,
    keep_points: int,
    corrected: Sequence[SessionPoint] = (),
) -> None:
    """Store the outcome of a frame with the earlier points that it corrects, and delete all but the last `keep_points`
    points.

    Raises `NotFoundError` when the session was deleted meanwhile, `ConflictError` when another server has answered the
    same frame.
    """
    here = sessions.c.id == session.id
    values: dict[str, Any] = {"memory": memory, "frames": point.frame, "active_at": now()}
    if camera != session.camera:
        values["camera"] = camera
    if connection.execute(update(sessions).where(here).values(**values)).rowcount == 0:
        raise _gone(session.id)
    row = {name: getattr(point, name) for name in SessionPoint.__slots__}
    try:
        connection.execute(insert(session_points).values(session_id=session.id, **row))
    except IntegrityError:
        raise ConflictError(
            "Another server has answered a frame of this session; send the next one."
        ) from None
    if corrected:
        _correct(connection, session.id, corrected)
    old = session_points.c.frame <= point.frame - keep_points
    connection.execute(delete(session_points).where((session_points.c.session_id == session.id) & old))


def _correct(connection: Connection, session_id: str, points: Sequence[SessionPoint]) -> None:
    """Store other places of points that are there."""
    where = (session_points.c.session_id == session_id) & (session_points.c.frame == bindparam("of_frame"))
    rows = [
        {"of_frame": point.frame, "pose": point.pose, "floor": point.floor, "plan": point.plan}
        for point in points
    ]
    connection.execute(update(session_points).where(where), rows)


def delete_session(connection: Connection, session_id: str) -> None:
    """Delete a session with its trajectory; raises `NotFoundError`."""
    if connection.execute(delete(sessions).where(sessions.c.id == session_id)).rowcount == 0:
        raise _gone(session_id)


def delete_expired_sessions(connection: Connection, timeout: timedelta) -> int:
    """Delete sessions without a frame for longer than `timeout`; return their number."""
    return connection.execute(delete(sessions).where(sessions.c.active_at < now() - timeout)).rowcount


def list_points(connection: Connection, session_id: str, count: int) -> list[SessionPoint]:
    """Return the last `count` points of a trajectory, oldest first."""
    query = (
        select(session_points)
        .where(session_points.c.session_id == session_id)
        .order_by(session_points.c.frame.desc())
        .limit(count)
    )
    rows = connection.execute(query).all()
    return [
        SessionPoint(**{name: getattr(row, name) for name in SessionPoint.__slots__})
        for row in reversed(rows)
    ]


def _gone(session_id: str) -> NotFoundError:
    return NotFoundError(
        f"There is no session {session_id!r}; it may have expired. POST /sessions starts another."
    )


def _session(row: Row[tuple[Any, ...]]) -> Session:
    created, active = as_utc(row.created_at), as_utc(row.active_at)
    assert created is not None and active is not None  # noqa: S101, PT018 - the columns are not nullable
    return Session(
        id=row.id,
        venue_id=row.venue_id,
        camera=row.camera,
        destination=row.destination,
        language=row.language,
        memory=row.memory,
        frames=row.frames,
        created_at=created,
        active_at=active,
        share=row.share,
    )
