"""Liveness, readiness and metrics."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from typing import Any, Literal

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import SQLAlchemyError

from app.api.deps import AppState, CallerOf, State, public, require
from app.api.errors import problem
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.errors import RoomfixError
from app.limits import limit
from app.storage.builds import count_builds, count_queued

router = APIRouter(tags=["operation"], route_class=ContractRoute)


class Health(BaseModel):
    """The state of the server."""

    model_config = ConfigDict(json_schema_extra={"example": {"status": "ok"}})

    status: str


class Readiness(BaseModel):
    """Whether queries can be answered, part by part."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"status": "ok", "checks": {"database": "ok", "blobs": "ok", "build_worker": "ok"}}
        }
    )

    status: Literal["ok", "degraded"] = Field(
        description="degraded: queries are answered, but a part needs an operator"
    )
    checks: dict[str, str] = Field(description="By part: ok, or what is wrong with it")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadinessOptions:
    """When a part of the server counts as ready."""

    min_free_bytes: int = limit(
        2_000_000_000,
        "A disk with less free space than this is nearly full.",
        chosen="By hand: a scan of some minutes and the map that is built from it still fit.",
    )


OPTIONS = ReadinessOptions()
# Parts without which no query is answered.
NEEDED = ("database", "blobs")
# An open server refuses every call that comes by a name other than localhost.
FOREIGN: dict[int | str, dict[str, Any]] = {403: problems(403)[403]}


@router.head("/healthz", name="headHealth", dependencies=[Depends(public)], include_in_schema=False)
@router.get("/healthz", name="getHealth", dependencies=[Depends(public)], responses=FOREIGN)
async def healthz() -> Health:
    """Answer as long as the process lives."""
    return Health(status="ok")


@router.get(
    "/readyz",
    name="getReadiness",
    response_model=Readiness,
    responses={**FOREIGN, 503: {"model": Readiness}},
    dependencies=[Depends(public)],
)
def readyz(state: State) -> Readiness | Response:
    """Answer 200 when database and blobs are there and the server is not about to stop; `status` and `checks` say what
    else needs an operator."""
    if state.drain.is_leaving:
        return problem(503, "not_ready", "The server is stopping; it answers what still comes.")
    checks = {
        "database": _database(state),
        "blobs": _blobs(state),
        "disk": _disk(state),
        "models": _models(state),
        # Without the worker builds wait, but queries are answered: that is no reason to take the server out.
        "build_worker": "ok"
        if state.runner.alive()
        else "The build worker is not running; it is being restarted.",
        "maps": _maps(state),
    }
    if any(checks[part] != "ok" for part in NEEDED):
        return problem(503, "not_ready", "A part of the server doesn't answer.", checks=checks)
    is_ok = all(check == "ok" for check in checks.values())
    return Readiness(status="ok" if is_ok else "degraded", checks=checks)


def _database(state: AppState) -> str:
    try:
        state.services.resources.database.ping()
    except SQLAlchemyError as error:
        return type(error).__name__
    except RoomfixError as error:
        return str(error)
    return "ok"


def _blobs(state: AppState) -> str:
    try:
        state.services.resources.blobs.check_writable()
    except (OSError, RoomfixError) as error:
        return str(error)
    return "ok"


def _disk(state: AppState) -> str:
    free = shutil.disk_usage(state.services.resources.settings.data_dir).free
    if free < OPTIONS.min_free_bytes:
        return f"The disk of the data folder is nearly full: {free / 1e6:,.0f} MB are free."
    return "ok"


def _models(state: AppState) -> str:
    path = state.services.resources.models.descriptor_path
    return "ok" if path.is_file() else f"The model {path.name} is missing; the server can't be started again."


def _maps(state: AppState) -> str:
    problems = state.services.maps.problems
    return " ".join(f"Venue {venue}: {problem}" for venue, problem in sorted(problems.items())) or "ok"


@router.get(
    "/metrics",
    name="getMetrics",
    response_class=Response,
    dependencies=[Depends(require("admin"))],
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}, **problems(401)},
)
def metrics(state: State, caller: CallerOf) -> Response:
    """Return metrics in Prometheus's text format; they are of all venues."""
    caller.check_venue(None)
    resources = state.services.resources
    state.metrics.pending.set(state.executor.pending)
    with resources.database.read() as connection:
        state.metrics.set_builds(count_builds(connection))
        state.metrics.set_queued(count_queued(connection))
    state.metrics.free_bytes.set(shutil.disk_usage(resources.settings.data_dir).free)
    state.metrics.worker_alive.set(state.runner.alive())
    state.metrics.damaged_maps.set(len(state.services.maps.problems))
    return Response(state.metrics.render(), media_type="text/plain; version=0.0.4; charset=utf-8")
