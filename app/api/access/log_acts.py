"""What administrators change is noted in the audit log."""

from __future__ import annotations

import logging

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from app.api.deps import AppState, caller_of
from app.errors import DatabaseBusyError
from app.storage.audit import Act

log = logging.getLogger("roomfix.api")
READING = ("GET", "HEAD", "OPTIONS")
# Where a request's scope holds the venue that an act was about, when its path doesn't name it.
VENUE = "roomfix.venue"


async def log_act(request: Request, response: Response) -> None:
    """Note an act that has succeeded, before its answer is sent; an open server has nobody to note."""
    caller = caller_of(request)
    # A call that only reads is noted when its route names the venue: that of the export does.
    is_noted = request.method not in READING or VENUE in request.scope
    if not is_noted or caller.is_open or response.status_code >= 400:
        return
    state = request.app.state.roomfix
    assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
    act = Act(
        key_id=caller.key_id,
        key_name=caller.name,
        act=f"{request.method} {request.scope['route'].path}",
        target=request.url.path,
        venue_id=request.path_params.get("venue") or request.scope.get(VENUE) or caller.venue_id,
        address=None if request.client is None else request.client.host,
    )
    try:
        await run_in_threadpool(state.services.keys.note_act, act)
    except DatabaseBusyError:
        # What was done is done; its answer must not say otherwise.
        log.warning("an act is missing from the audit log: %s by %s", act.act, act.key_name)
