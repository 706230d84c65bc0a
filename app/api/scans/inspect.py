"""Inspection: what a scan holds and what a build would do with it."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from app.api.bodies.report import ScanExamination
from app.api.deps import CallerOf, State, require
from app.api.requests.build_options import OptionsField, read_options
from app.api.requests.contract_route import ContractRoute
from app.api.requests.scan_fields import ArchiveField, UploadField, archive_of
from app.api.schemas import problems
from app.engine.mapping.options import parse_build_options
from app.services.inspection.inspect_archive import inspect_archive

EXAMPLE: dict[str, Any] = {
    "recognised": [{"format": "tum", "folder": "", "missing": []}],
    "format": "tum",
    "frames": 500,
    "discarded": {},
    "sensors": {
        "color": {
            "model": "PINHOLE",
            "width": 640,
            "height": 480,
            "params": [525.505, 525.505, 320.0, 240.0],
        },
        "depth": {"width": 640, "height": 480, "share_of_pixels": 0.714, "percentiles_m": [0.89, 1.81, 2.87]},
    },
    "duration_s": 33.27,
    "rate_hz": 15.0,
    "trajectory": {"path_m": 7.44, "extent_m": [1.89, 1.12, 0.38], "z_up": True},
    "examination": {"verdict": "confirmed", "pairs_tried": 12, "pairs": 11, "findings": []},
    "loops": {"compared": 24, "found": 11, "error_m": 0.016},
    "build": {
        "would": "build",
        "keyframes": 47,
        "supporting_frames": 89,
        "points": "from depth",
        "plan_positions": True,
        "pictures": None,
        "camera": None,
        "scale": None,
    },
    "notes": [],
    "path_svg": '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 640"/>',
}

router = APIRouter(
    prefix="/database", tags=["maps"], dependencies=[Depends(require("admin"))], route_class=ContractRoute
)


class RecognisedBody(BaseModel):
    """A format by the names of the files alone."""

    format: str
    folder: str
    missing: list[str] = Field(description="What a scan of this format needs and the archive lacks")


class ColorSensorBody(BaseModel):
    """The camera of the colour images."""

    model: str
    width: int
    height: int
    params: list[float]


class DepthSensorBody(BaseModel):
    """The depth images."""

    width: int
    height: int
    share_of_pixels: float = Field(description="Pixels that have a depth, over all")
    percentiles_m: list[float] = Field(description="The 5th, 50th and 95th percentile of the depths")


class SensorsBody(BaseModel):
    """What the scan was taken with; `depth` is null for a scan of colour images alone."""

    color: ColorSensorBody
    depth: DepthSensorBody | None


class TrajectoryBody(BaseModel):
    """The path of the camera."""

    path_m: float
    extent_m: tuple[float, float, float]
    z_up: bool = Field(description="Whether the extent's z is known to be the height")


class LoopsBody(BaseModel):
    """Frames far apart on the way whose pictures show the same place; a few pairs of those whose poses are near."""

    compared: int = Field(description="Pairs of frames that were compared")
    found: int = Field(description="Pairs that see the same place by their features and depth")
    error_m: float | None = Field(
        description="Median difference of their motion by the poses from that by the pictures: more than a few "
        "centimetres is drift, which a build corrects where it can; null for too few pairs"
    )


class PlannedBuildBody(BaseModel):
    """What a build with these options would do."""

    would: str = Field(
        description="`build`, `refuse` with what the examination found, or `estimate_poses` of pictures without poses"
    )
    keyframes: int | None = Field(description="By the pose rule, before blurred ones are left out")
    supporting_frames: int | None
    points: str
    plan_positions: bool = Field(
        description="Whether answers would have a place on the floor plan; of pictures without poses, if up is found"
    )
    pictures: int | None = Field(
        description="About how many poses would be estimated, by the first pictures; null for a scan with poses",
    )
    camera: str | None = Field(
        description="What is known of their camera: `given`, `exif`, or `guess`, which is calibrated by the pictures",
    )
    scale: str | None = Field(
        description="What their scale would be taken from: `distance`, `marker`, `camera_height`, `correspondences` or "
        "`depth`; null for none",
    )


class InspectionBody(BaseModel):
    """What a scan holds."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": EXAMPLE})

    recognised: list[RecognisedBody]
    format: str
    frames: int
    discarded: dict[str, int] = Field(description="Frames left out, by reason")
    sensors: SensorsBody
    duration_s: float
    rate_hz: float | None
    trajectory: TrajectoryBody | None = Field(description="null for pictures without poses")
    examination: ScanExamination | None
    loops: LoopsBody | None = Field(
        description="null without depth, without an examination, and where that found more than drift"
    )
    build: PlannedBuildBody
    notes: list[str]
    path_svg: str | None = Field(
        description="The path from above; green is the start, dots are keyframes; null for pictures without poses"
    )


@router.post("/inspect", name="inspectScan", responses=problems(401, 404, 409, 413, 422, 503))
async def inspect(
    state: State,
    caller: CallerOf,
    archive: ArchiveField = None,
    upload: UploadField = None,
    options: OptionsField = "{}",
) -> InspectionBody:
    """Say what a scan holds and what a build would do with it. Takes some seconds, builds and changes nothing.

    An upload stays as it is, and can be built next.
    """
    parsed = parse_build_options(read_options(options))
    sent = await run_in_threadpool(archive_of, archive, upload, state.services.uploads, caller.venue_id)
    found = await state.executor.run(lambda: inspect_archive(state.services.resources, parsed, sent))
    return InspectionBody.model_validate(found)
