"""What a build reports of its map; the statistics of a map version are the same."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.bodies.anchor import StatedCamera

FigureValue = bool | int | float | str | list[float] | None
OptionValue = bool | int | float | str | list[float] | list[list[float]] | StatedCamera | None


class OpenBody(BaseModel):
    """An object that may hold more than its model names: what builds report grows."""

    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, Any] = Field(init=False)


class Placement(OpenBody):
    """How the scan was brought into the venue's world."""

    source: str = Field(description="given, gravity, registered or scan_frame")
    z_up: bool = Field(False, description="Whether the world's z is known to point up")
    has_scale: bool = Field(True, description="Whether the map is in metres, or in a unit of its own")


class SelfCheckFigures(OpenBody):
    """Frames of the scan that were located in the map before it was published."""

    tried: int
    located: int
    expected: int | None = None
    median_position_m: float | None = None
    median_orientation_deg: float | None = None


class Finding(OpenBody):
    """Something that is wrong with a scan, and the options of a build that would mend it."""

    code: str = Field(description="Stable, for programs")
    sentence: str
    severity: str
    options: dict[str, OptionValue] = Field(description="Of a build")
    certain: bool = Field(description="Whether `repair` uses the options by itself")
    figures: dict[str, FigureValue]


class ScanExamination(OpenBody):
    """What was found to be right or wrong in a scan."""

    __pydantic_extra__: dict[str, FigureValue] = Field(init=False)

    verdict: str
    findings: list[Finding]


class SourcedFigures(OpenBody):
    """What something rests on, and its figures."""

    __pydantic_extra__: dict[str, FigureValue] = Field(init=False)

    source: str


class CalibratedCamera(BaseModel):
    """The camera of pictures whose poses were estimated."""

    source: str = Field(description="given, exif_calibrated or self_calibrated")
    model: str
    params: list[float]


class PicturesPart(BaseModel):
    """Pictures that are connected with each other and not with the map's."""

    frames: int
    first: str
    last: str


class RevisitFigures(BaseModel):
    """Pictures of a video that match others from another time: one place seen twice, or places that look alike."""

    compared: int = Field(description="Pairs of pictures that match")
    measured: int = Field(description="Those whose motion could be measured")
    within_drift: int = Field(description="Those that may be one place by the path between them")
    agreeing: int = Field(description="Those that tie the path together")


class FloorFigures(BaseModel):
    """The floor that the pictures show, by the points on it."""

    points: int
    camera_height_m: float | None = Field(
        description="Median height of the camera above it; null without scale"
    )
    camera_height_varies_by: float = Field(
        description="Between the stretches of the walk (80 percent of them), relative to the height"
    )


class EstimatedPoses(OpenBody):
    """Poses that were estimated from pictures without any."""

    pictures: int = Field(description="Pictures that were sent")
    chosen: int = Field(description="Those chosen by motion and sharpness")
    connected: int = Field(description="Those whose poses were found")
    joined_parts: int = Field(
        default=1,
        description="Parts of a video's path that were joined to the one whose pictures are connected",
    )
    other_parts: list[PicturesPart]
    revisits: RevisitFigures | None = Field(default=None, description="Null for photos in no order")
    points: int
    error_px: float = Field(description="Mean reprojection error")
    camera: CalibratedCamera
    scale: SourcedFigures = Field(
        description="Source distance, marker, camera_height, correspondences, depth or none"
    )
    up: SourcedFigures = Field(description="Source vertical_edges, camera_axes or none")
    floor: FloorFigures | None = Field(
        default=None, description="Null where too few pictures show one level floor"
    )


class LoopFigures(BaseModel):
    """Places that the scan passes twice, and the drift that they show."""

    compared: int = Field(description="Pairs of frames that were compared")
    found: int = Field(description="Those that see the same place")
    held_back: int = Field(description="Those that judge the correction and are not used by it")
    before_m: float | None = Field(description="Their median error by the scan's poses")
    after_m: float | None = Field(description="The same after the correction by the others")
    applied: bool = Field(description="Whether the poses were corrected")
    moved_m: float = Field(description="By how far a frame was moved at most")


class FittedThresholds(BaseModel):
    """As `keyframes.position_m` and `keyframes.attitude_rad` of a build take them."""

    position_m: float
    attitude_rad: float


class FittedCurve(BaseModel):
    """matches = a x^b around the threshold; errors in matches, differences in metres or radians."""

    a: float
    b: float
    rmse_fit: float
    rmse_validation: float | None = Field(description="Of the pairs held back from the fit")
    pairs_fit: int
    pairs_validation: int
    threshold: float
    reached: Literal["within", "beyond", "below"] = Field(
        description="beyond: more matches are left even at the largest difference; below: fewer at the smallest"
    )
    left_at_threshold: float | None = Field(
        description="Median matches of held-back pairs around the threshold"
    )
    range: tuple[float, float] = Field(description="Differences that the curve is fitted to")
    other_limit: float = Field(description="Largest other difference (rad or m) of its pairs")


class FittedKeyframes(OpenBody):
    """Keyframe thresholds that were fitted to the scan, and the curves that they follow from."""

    wanted_matches: float
    features: str
    frames: int
    thresholds: FittedThresholds
    position: FittedCurve
    attitude: FittedCurve
    warnings: list[str]


class BuildReport(OpenBody):
    """What became of a scan. A map of an older server may lack some of the fields."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "example": {
                "warnings": [],
                "frames": 2400,
                "discarded": {"blurred": 74},
                "keyframes": 2236,
                "features": 914228,
                "feature_method": "sift",
                "map_keyframes": 2236,
                "bytes": {"features": 144650560, "index": 36634669},
                "seconds": {"describe": 87.9, "refine": 38.9},
                "world_from_scan": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
                "placement": {"source": "given", "z_up": True},
                "self_check": {"tried": 24, "expected": 20, "located": 11, "median_position_m": 0.00095},
            }
        },
    )

    repaired: str | None = Field(None, description="What `repair` changed, in words")
    repairs: dict[str, OptionValue] = Field({}, description="The options that it used")
    warnings: list[str] = []
    frames: int | None = Field(None, description="Frames of the scan")
    discarded: dict[str, int] = Field({}, description="Number of frames left out, by reason")
    discarded_frames: dict[str, list[str]] = Field({}, description="The first of them by name")
    notes: list[str] = []
    replaced: dict[str, str] = Field({}, description="Discarded keyframe -> the frame in its place")
    keyframes: int | None = Field(None, description="Keyframes of this scan")
    features: int | None = None
    feature_method: str | None = None
    map_keyframes: int | None = Field(None, description="Keyframes of the whole map")
    bytes: dict[str, int] = Field({}, description="Size of the map's files")
    seconds: dict[str, float] = Field({}, description="Time by stage")
    world_from_scan: list[list[float]] | None = Field(None, description="The 4x4 that was used")
    placement: Placement | None = None
    examination: ScanExamination | None = None
    structure: EstimatedPoses | None = Field(
        None, description="How poses were estimated from pictures that had none"
    )
    loops: LoopFigures | None = None
    self_check: SelfCheckFigures | None = None
    lens: dict[str, float] | None = None
    calibration: FittedKeyframes | None = None
