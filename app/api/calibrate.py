"""Calibration: the keyframe thresholds that suit a venue's own scan."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from app.api.bodies.report import FittedCurve, FittedThresholds
from app.api.deps import CallerOf, State, require
from app.api.requests.build_options import OptionsField, read_options
from app.api.requests.contract_route import ContractRoute
from app.api.requests.scan_fields import ArchiveField, UploadField, archive_of
from app.api.schemas import problems
from app.services.calibration import calibrate_archive

router = APIRouter(
    prefix="/database", tags=["maps"], dependencies=[Depends(require("admin"))], route_class=ContractRoute
)


class CalibrationPoint(BaseModel):
    """One pair of frames: difference in metres or radians, verified matches, kept for validation or fitted to."""

    difference: float
    matches: int
    held_back: bool


class CurveBody(FittedCurve):
    """A fitted curve with its pairs."""

    points: list[CalibrationPoint]


CURVE: dict[str, Any] = {
    "a": 19.4,
    "b": -0.54,
    "rmse_fit": 12.1,
    "rmse_validation": 13.0,
    "pairs_fit": 300,
    "pairs_validation": 100,
    "threshold": 0.24,
    "reached": "within",
    "left_at_threshold": 51.0,
    "range": [0.02, 1.0],
    "other_limit": 0.2,
    "points": [{"difference": 0.1, "matches": 140, "held_back": False}],
}


class CalibrationBody(BaseModel):
    """Both curves of a scan and the keyframe thresholds that follow."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "wanted_matches": 50,
                "features": "sift",
                "frames": 120,
                "thresholds": {"position_m": 0.24, "attitude_rad": 0.17},
                "position": CURVE,
                "attitude": CURVE,
                "warnings": [],
            }
        }
    )

    wanted_matches: float
    features: str
    frames: int = Field(description="Frames of the scan that were compared")
    thresholds: FittedThresholds
    position: CurveBody
    attitude: CurveBody
    warnings: list[str]


@router.post("/calibrate", name="calibrateThresholds", responses=problems(401, 404, 409, 413, 422, 503))
async def calibrate(
    state: State,
    caller: CallerOf,
    venue: Annotated[str, Form(min_length=1, description="The venue that the scan is of")],
    archive: ArchiveField = None,
    upload: UploadField = None,
    options: OptionsField = "{}",
) -> CalibrationBody:
    """Fit matches over pose difference to a scan and answer with the keyframe thresholds for it.

    Takes some seconds and changes nothing; an upload stays, for a build. `options.keyframes.wanted_matches` says how
    many matches a frame must share with its nearest keyframe. A build does the same by itself with `{"keyframes":
    {"thresholds": "calibrated"}}`.
    """
    caller.check_venue(venue)
    parsed = read_options(options)
    sent = await run_in_threadpool(archive_of, archive, upload, state.services.uploads, venue)
    found = await state.executor.run(lambda: calibrate_archive(state.services.resources, venue, parsed, sent))
    return CalibrationBody.model_validate(found)
