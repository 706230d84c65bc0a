"""Liveness, readiness and metrics."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict
from sqlalchemy.exc import SQLAlchemyError

from app.api.deps import CallerOf, State, public, require
from app.api.errors import problem
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems

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

    status: str
    checks: dict[str, str]


@router.head("/healthz", name="headHealth", dependencies=[Depends(public)], include_in_schema=False)
@router.get("/healthz", name="getHealth", dependencies=[Depends(public)])
def healthz() -> Health:
    """Answer as long as the process lives."""
    return Health(status="ok")


@router.get(
    "/readyz",
    name="getReadiness",
    response_model=Readiness,
    responses={503: {"model": Readiness}},
    dependencies=[Depends(public)],
)
def readyz(state: State) -> Readiness | Response:
    """Answer 200 when database, blobs and build worker are there."""
    checks: dict[str, str] = {}
    try:
        state.services.resources.database.ping()
        checks["database"] = "ok"
    except SQLAlchemyError as error:
        checks["database"] = type(error).__name__
    try:
        state.services.resources.blobs.check_writable()
        checks["blobs"] = "ok"
    except OSError as error:
        checks["blobs"] = str(error)
    # Without the worker builds wait, but queries are answered: that is no reason to take the server out.
    checks["build_worker"] = "ok" if state.runner.alive() else "restarting"
    if checks["database"] != "ok" or checks["blobs"] != "ok":
        return problem(503, "not_ready", "A part of the server doesn't answer.", checks=checks)
    return Readiness(status="ok", checks=checks)


@router.get(
    "/metrics",
    name="getMetrics",
    response_class=Response,
    dependencies=[Depends(require("admin"))],
    responses=problems(401),
)
def metrics(state: State, caller: CallerOf) -> Response:
    """Return metrics in Prometheus's text format; they are of all venues."""
    caller.check_venue(None)
    state.metrics.pending.set(state.executor.pending)
    return Response(state.metrics.render(), media_type="text/plain; version=0.0.4; charset=utf-8")
