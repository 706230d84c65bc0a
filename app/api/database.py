"""Builds: from an uploaded scan to a map, watched and cancelled."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Header, Query
from pydantic import BaseModel, ConfigDict, Field
from sse_starlette.sse import EventSourceResponse
from starlette.concurrency import run_in_threadpool

from app.api.bodies.report import BuildReport
from app.api.deps import AppState, CallerOf, State, require
from app.api.requests.build_options import OptionsField, read_options
from app.api.requests.contract_route import ContractRoute
from app.api.requests.paging import Paged
from app.api.requests.scan_fields import ArchiveField, UploadField, check_one_scan
from app.api.schemas import problems
from app.build_kinds import Kind
from app.errors import NotFoundError
from app.limits import limit
from app.services.submit_build import submit_build, submit_upload, withdraw_build
from app.storage.builds import Build, get_build, list_builds

router = APIRouter(
    prefix="/database", tags=["maps"], dependencies=[Depends(require("admin"))], route_class=ContractRoute
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildEventsOptions:
    """How a build is watched."""

    interval_s: float = limit(
        0.3,
        "Time between two reads of a build that is watched by server-sent events.",
        chosen="By hand: progress looks smooth, and one indexed row is read each time.",
    )


OPTIONS = BuildEventsOptions()
# OpenAPI 3.1 describes a stream as a whole, which is text; the member of its version 3.2 for each event has a name of
# its own here until generators of clients know it.
EVENTS: dict[str, Any] = {
    "description": "Events named build, whose data is the build as getBuild answers it, as JSON",
    "content": {
        "text/event-stream": {
            "schema": {"type": "string"},
            "x-item-schema": {
                "type": "object",
                "properties": {
                    "event": {"const": "build"},
                    "data": {
                        "type": "string",
                        "contentMediaType": "application/json",
                        "contentSchema": {"$ref": "#/components/schemas/BuildBody"},
                    },
                },
                "required": ["event", "data"],
            },
        }
    },
}


class Submitted(BaseModel):
    """A queued build and where to watch it."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "build": "0d8f5b5c2f0a4f1e9a6c1b2d3e4f5a6b",
                "status_url": "/database/builds/0d8f5b5c2f0a4f1e9a6c1b2d3e4f5a6b",
                "events_url": "/database/builds/0d8f5b5c2f0a4f1e9a6c1b2d3e4f5a6b/events",
            }
        }
    )

    build: str
    status_url: str
    events_url: str


class BuildBody(BaseModel):
    """A build as it is now; `report` when it has succeeded, `error` when it has failed."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "build": "0d8f5b5c2f0a4f1e9a6c1b2d3e4f5a6b",
                "venue": "museum",
                "kind": "scan",
                "priority": 0,
                "state": "running",
                "stage": "describe",
                "done": 120,
                "total": 480,
                "attempts": 1,
                "error": None,
                "error_code": None,
                "report": None,
                "map_version": None,
                "created_at": "2026-03-01T09:00:00+00:00",
                "started_at": "2026-03-01T09:00:01+00:00",
                "finished_at": None,
            }
        }
    )

    build: str
    venue: str
    kind: Kind = Field(description="scan, recording (a phone's walk) or pictures (photos or a video)")
    priority: int = Field(description="Of two that wait the one with the higher number is begun first")
    state: str = Field(description="queued, running, succeeded, failed or cancelled")
    stage: str | None
    done: int
    total: int
    attempts: int
    error: str | None
    error_code: str | None
    report: BuildReport | None
    map_version: int | None
    created_at: str | None
    started_at: str | None
    finished_at: str | None

    @staticmethod
    def of(build: Build) -> BuildBody:
        """Return the body of a build."""
        times = {
            name: None if getattr(build, name) is None else getattr(build, name).isoformat()
            for name in ("created_at", "started_at", "finished_at")
        }
        return BuildBody(
            build=build.id,
            venue=build.venue_id,
            kind=build.kind,
            priority=build.priority,
            state=build.state,
            stage=build.stage,
            done=build.done,
            total=build.total,
            attempts=build.attempts,
            error=build.error,
            error_code=build.error_code,
            report=build.report,
            map_version=build.map_version,
            **times,
        )


@router.post("/build", name="buildMap", status_code=202, responses=problems(401, 404, 409, 413, 422))
def build(
    state: State,
    caller: CallerOf,
    venue: Annotated[str, Form(min_length=1, description="The venue that the map is for")],
    archive: ArchiveField = None,
    upload: UploadField = None,
    options: OptionsField = "{}",
    priority: Annotated[
        int,
        Form(
            ge=-9,
            le=9,
            description="Of two builds that wait the one with the higher number is begun first; more than 0 needs a "
            "key of all venues",
        ),
    ] = 0,
    idempotency_key: Annotated[
        str | None,
        Header(
            min_length=1,
            max_length=64,
            description="Any text of the client's own: the same upload sent again with it is the same build",
        ),
    ] = None,
) -> Submitted:
    """Queue a build of a map from an RGB-D scan."""
    # A key of one venue must not put its builds before those of others.
    caller.check_venue(None if priority > 0 else venue)
    resources, uploads, parsed = state.services.resources, state.services.uploads, read_options(options)
    check_one_scan(archive, upload)
    if archive is not None:
        build_id = submit_build(resources, venue, parsed, archive.file, idempotency_key, priority)
    else:
        build_id = submit_upload(resources, uploads, venue, parsed, upload or "", idempotency_key, priority)
    state.runner.wake()
    url = f"/database/builds/{build_id}"
    return Submitted(build=build_id, status_url=url, events_url=f"{url}/events")


@router.get("/builds", name="listBuilds", response_model_exclude_unset=True, responses=problems(401, 422))
def list_all(
    state: State,
    caller: CallerOf,
    page: Paged,
    venue: Annotated[str | None, Query(description="Of this venue only")] = None,
) -> list[BuildBody]:
    """List builds, newest first."""
    with state.services.resources.database.read() as connection:
        found = list_builds(connection, caller.venue_or_own(venue))
    return [BuildBody.of(item) for item in page.of(found, lambda build: build.id)]


@router.get(
    "/builds/{build}", name="getBuild", response_model_exclude_unset=True, responses=problems(401, 404, 422)
)
def status(state: State, build: str) -> BuildBody:
    """Return where a build is."""
    return _read(state, build)


@router.get(
    "/builds/{build}/events",
    name="watchBuild",
    response_class=EventSourceResponse,
    responses={200: EVENTS, **problems(401, 404, 422)},
)
async def events(state: State, build: str) -> EventSourceResponse:
    """Send the build as a server-sent event whenever it changes, until it has ended."""
    first = await run_in_threadpool(_read, state, build)
    return EventSourceResponse(_follow(state, first))


@router.delete(
    "/builds/{build}",
    name="cancelBuild",
    response_model_exclude_unset=True,
    status_code=202,
    responses=problems(401, 404, 409, 422),
)
def cancel(state: State, build: str) -> BuildBody:
    """Cancel a build; a running one stops at its next step."""
    return BuildBody.of(withdraw_build(state.services.resources, build))


async def _follow(state: AppState, body: BuildBody) -> AsyncIterator[dict[str, str]]:
    sent = None
    # A server that stops ends the stream; its reader comes back to another one.
    while not state.drain.closing.is_set():
        if body != sent:
            yield {"event": "build", "data": body.model_dump_json(exclude_unset=True)}
            sent = body
        if body.state in ("succeeded", "failed", "cancelled"):
            return
        await asyncio.sleep(OPTIONS.interval_s)
        try:
            body = await run_in_threadpool(_read, state, body.build)
        except NotFoundError:
            # The venue was deleted, and its builds with it.
            return


def _read(state: AppState, build: str) -> BuildBody:
    with state.services.resources.database.read() as connection:
        return BuildBody.of(get_build(connection, build))
