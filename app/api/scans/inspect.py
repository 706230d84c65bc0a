"""Inspection: what a scan holds and what a build would do with it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, UploadFile
from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import State, require
from app.api.requests.build_options import OptionsField, read_options
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import problems
from app.engine.mapping.options import parse_build_options
from app.services.inspection.inspect_archive import inspect_archive

router = APIRouter(
    prefix="/database", tags=["maps"], dependencies=[Depends(require("admin"))], route_class=ContractRoute
)


class RecognisedBody(BaseModel):
    """A format by the names of the files alone."""

    format: str
    folder: str
    missing: list[str] = Field(description="What a scan of this format needs and the archive lacks")


class TrajectoryBody(BaseModel):
    """The path of the camera."""

    path_m: float
    extent_m: tuple[float, float, float]
    z_up: bool = Field(description="Whether the extent's z is known to be the height")


class PlannedBuildBody(BaseModel):
    """What a build with these options would do."""

    would: str = Field(description="`build`, or `refuse` with what the examination found")
    keyframes: int | None = Field(description="By the pose rule, before blurred ones are left out")
    supporting_frames: int | None
    points: str
    plan_positions: bool = Field(description="Whether answers would have a place on the floor plan")


class InspectionBody(BaseModel):
    """What a scan holds."""

    model_config = ConfigDict(extra="forbid")

    recognised: list[RecognisedBody]
    format: str
    frames: int
    discarded: dict[str, int] = Field(description="Frames left out, by reason")
    sensors: dict[str, dict[str, Any] | None]
    duration_s: float
    rate_hz: float | None
    trajectory: TrajectoryBody
    examination: dict[str, Any] | None
    build: PlannedBuildBody
    notes: list[str]
    path_svg: str = Field(description="The path from above; green is the start, dots are keyframes")


@router.post("/inspect", responses=problems(401, 413, 422, 503))
async def inspect(
    state: State,
    archive: Annotated[UploadFile, File(description="The scan: zip, tar or recording")],
    options: OptionsField = "{}",
) -> InspectionBody:
    """Say what a scan holds and what a build would do with it. Takes some seconds, builds and changes nothing."""
    parsed = parse_build_options(read_options(options))
    found = await state.executor.run(lambda: inspect_archive(state.services.resources, parsed, archive.file))
    return InspectionBody.model_validate(found)
