"""Locate: an image in, a pose and a point on the plan out."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Depends, File, Form, UploadFile
from pydantic import BaseModel, ConfigDict, Field

from app.api.bodies.earth import GEOPOSE, GeoPoseBody
from app.api.deps import CallerOf, State, require
from app.api.requests.axes import (
    DEVICE_POSE_IN_WORDS,
    OPENCV,
    Axes,
    AxesName,
    Frames,
    parse_frames,
)
from app.api.requests.axes import IN_WORDS as AXES_IN_WORDS
from app.api.requests.contract_route import ContractRoute
from app.api.requests.names import known_names, refuse_unknown_keys
from app.api.requests.read_json import read_json
from app.api.requests.several_frames import (
    CAMERAS_IN_WORDS,
    IMAGES_IN_WORDS,
    MOTION_IN_WORDS,
    later_frames,
)
from app.api.schemas import CameraBody, PoseBody, problems
from app.engine.floors.earth import GeoPoseReason
from app.engine.query.hints import Hint
from app.engine.query.narrowing import Prior
from app.engine.query.shown_matches import ShownMatches
from app.errors import InvalidInputError
from app.geometry.camera_hint import CameraHint, parse_camera_hint
from app.services.locate_result import LocateRequest, LocateResult, Method
from app.vision.image_files.formats import FORMATS_IN_WORDS

router = APIRouter(tags=["locate"], dependencies=[Depends(require("locate"))], route_class=ContractRoute)


IN_OWN_AXES = Frames()
MAX_RISK_IN_WORDS = (
    "Refuse a pose whose probability of being off by 0.5 m or 5 degrees is higher (1 - confidence); poses below the "
    "service's own limits are refused whatever is sent"
)
EXAMPLE: dict[str, Any] = {
    "located": True,
    "reason": None,
    "method": "rgbd",
    "venue": "museum",
    "map_version": 3,
    "floor": "0",
    "pose": {
        "position": {"x": 13.912, "y": 15.635, "z": 1.67},
        "quaternion": {"x": -0.3618, "y": -0.6083, "z": 0.6562, "w": 0.2617},
    },
    "plan": {"x": 14.865, "y": 17.163, "heading_deg": 307.5, "u_px": 1438.2, "v_px": 1453.8, "area": "hall"},
    "accuracy": {"position_m": 0.017, "orientation_deg": 0.23},
    "confidence": 0.987,
    "inliers": 151,
    "matches": 212,
    "keyframes": [{"keyframe": 151, "matches": 102, "inliers": 94}],
    "camera": {
        "model": "PINHOLE",
        "width": 640,
        "height": 480,
        "params": [498.0, 498.5, 322.4, 236.8],
        "source": "request",
    },
    "narrowed": False,
    "gravity_checked": None,
    "timings_ms": {
        "decode": 3.3,
        "describe": 37.6,
        "retrieve": 1.0,
        "match": 15.2,
        "pose": 9.1,
        "total": 67.9,
    },
    "anchors": [],
    "vertical": None,
    "hints": [],
    "geopose": GEOPOSE,
    "geopose_reason": None,
    "frames": [],
}


class PlanBody(BaseModel):
    """A point on the floor plan: metres, degrees counter-clockwise from plan x, pixels of the plan image."""

    x: float
    y: float
    heading_deg: float
    u_px: float | None
    v_px: float | None
    area: str | None = Field(None, description="Id of the area that the point is in")
    area_name: str | None = None
    nearest_landmark: str | None = Field(None, description="Id; in the same area if that has landmarks")
    nearest_landmark_name: str | None = None
    nearest_landmark_m: float | None = None


class AccuracyBody(BaseModel):
    """One sigma, from the pose covariance."""

    position_m: float
    orientation_deg: float


class KeyframeBody(BaseModel):
    """A keyframe that agrees with the pose."""

    keyframe: int
    matches: int
    inliers: int


class ShownMatchesBody(BaseModel):
    """Matches that agree with the pose, with the keyframe that shares most of them."""

    keyframe: int
    pairs: list[list[float]] = Field(description="u, v of the image, then u, v of the keyframe's picture")

    @staticmethod
    def of(shown: ShownMatches) -> ShownMatchesBody:
        """Return the body of matches, to a tenth of a pixel."""
        pairs = np.column_stack([shown.query_px, shown.keyframe_px]).round(1)
        return ShownMatchesBody(keyframe=shown.keyframe, pairs=pairs.tolist())


class FrameSupportBody(BaseModel):
    """The support of the pose by one frame of a query that has several."""

    inliers: int
    matches: int


class LocateResultBody(BaseModel):
    """Where the camera is, or the reason why that can't be said. `pose` is world_from_camera."""

    model_config = ConfigDict(json_schema_extra={"example": EXAMPLE})

    located: bool
    reason: (
        Literal["no_match", "too_few_inliers", "ambiguous", "outside_venue", "poor_image", "no_map"] | None
    )
    method: str
    venue: str
    map_version: int | None
    floor: str | None
    pose: PoseBody | None
    plan: PlanBody | None
    plan_reason: Literal["up_unknown", "scale_unknown"] | None = Field(
        None,
        description="Why a pose has no plan: the map's z axis isn't known to point up (build with gravity), or the map "
        "has no scale (build with scale; the pose and its accuracy are then in the map's own unit)",
    )
    accuracy: AccuracyBody | None
    confidence: float = Field(description="Probability that the error is below 0.5 m and 5 degrees")
    inliers: int
    matches: int
    keyframes: list[KeyframeBody]
    camera: CameraBody | None
    narrowed: bool = Field(
        description="Whether floor, area or prior held; false also when the search was widened"
    )
    gravity_checked: bool | None = Field(
        None, description="Whether the pose was compared with gravity; false where the map's down isn't known"
    )
    timings_ms: dict[str, float]
    anchors: list[str] = Field(description="The monitoring cameras that agree on the answer (method anchor)")
    vertical: Literal["gravity", "pois", "upright", "map"] | None = Field(
        description="What an anchor's answer takes as vertical; upright is an assumption"
    )
    axes: AxesName = Field("opencv", description="Axes of pose and session_from_world")
    session_from_world: PoseBody | None = Field(
        None, description="Moves points of the world into the app's own frame; with device_pose only"
    )
    hints: list[Hint] = Field(description="What would help a picture that isn't located, most helpful first")
    shown_matches: ShownMatchesBody | None = Field(None, description="Where `matches` asked for them")
    geopose: GeoPoseBody | None = Field(
        None, description="The camera on Earth, where the venue has an origin"
    )
    geopose_reason: GeoPoseReason | None = Field(
        None,
        description="Why a located camera has no geopose: the venue has no origin, the map's z axis isn't known to "
        "point up or its unit to be the metre, or the plan of the origin's floor has no known place in the world",
    )
    frames: list[FrameSupportBody] = Field(
        [], description="How each frame of a query with images supports the pose, image first"
    )


@router.post("/locate", name="locateImage", responses=problems(401, 404, 413, 415, 422, 503))
async def locate(
    state: State,
    caller: CallerOf,
    image: Annotated[UploadFile, File(description=FORMATS_IN_WORDS)],
    venue: Annotated[str | None, Form(description="May be left out when there is one venue")] = None,
    floor: Annotated[str | None, Form(description="Search this floor first")] = None,
    area: Annotated[str | None, Form(description="Search this area first: its id or name")] = None,
    camera: Annotated[
        str | None,
        Form(
            description='Intrinsics: "fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]" or JSON {model, width, height, params}'
        ),
    ] = None,
    gravity: Annotated[str | None, Form(description='Direction of down in camera axes, "x,y,z"')] = None,
    prior: Annotated[str | None, Form(description='JSON {"position": {x, y, z}, "radius_m"}')] = None,
    method: Annotated[Method, Form(description="auto asks the map, then the monitoring cameras")] = "auto",
    axes: Annotated[str | None, Form(description=AXES_IN_WORDS)] = None,
    device_pose: Annotated[str | None, Form(description=DEVICE_POSE_IN_WORDS)] = None,
    matches: Annotated[
        bool, Form(description="Answer with the matches that agree with the pose too")
    ] = False,
    max_risk: Annotated[float, Form(gt=0, le=1, description=MAX_RISK_IN_WORDS)] = 1.0,
    images: Annotated[list[UploadFile] | None, File(description=IMAGES_IN_WORDS)] = None,
    motion: Annotated[str | None, Form(description=MOTION_IN_WORDS)] = None,
    cameras: Annotated[str | None, Form(description=CAMERAS_IN_WORDS)] = None,
) -> LocateResultBody:
    """Locate one image, alone or by further frames of a burst or a rig.

    The pose is always that of `image`. With `motion` it is found by the features of all frames together; without it
    frames that are located alone must agree, and what they share with `image` helps to find it.
    """
    frames = parse_frames(axes, device_pose)
    hint = _camera(camera)
    request = LocateRequest(
        image=await image.read(),
        venue=caller.venue_or_own(venue or None),
        floor=floor or None,
        camera=hint,
        gravity=_gravity(gravity, frames.axes),
        prior=_prior(prior, frames.axes),
        method=method,
        area=area or None,
        show_matches=matches,
        max_risk=max_risk,
        later=await later_frames(images or (), motion, cameras, hint, frames.axes),
    )
    result = await state.executor.run(lambda: state.services.locate.locate(request))
    state.metrics.observe_query(result)
    return body_of(result, frames)


def body_of(result: LocateResult, frames: Frames = IN_OWN_AXES) -> LocateResultBody:
    """Return the body of a result, its poses in the axes that were asked for."""
    session_from_world = frames.session_from_world(result.world_from_camera)
    pose, plan = result.world_from_camera, result.plan
    return LocateResultBody(
        located=result.reason is None,
        reason=result.reason,
        method=result.method,
        venue=result.venue,
        map_version=result.map_version,
        floor=result.floor.id if result.floor is not None else None,
        pose=PoseBody.of(frames.axes.pose_out(pose)) if pose is not None else None,
        plan=None
        if plan is None
        else PlanBody(
            x=round(plan.x, 4),
            y=round(plan.y, 4),
            heading_deg=round(plan.heading_deg, 3),
            u_px=_rounded(plan.u_px, 2),
            v_px=_rounded(plan.v_px, 2),
            area=plan.area,
            area_name=plan.area_name,
            nearest_landmark=plan.nearest_landmark,
            nearest_landmark_name=plan.nearest_landmark_name,
            nearest_landmark_m=_rounded(plan.nearest_landmark_m, 3),
        ),
        plan_reason=result.plan_reason,
        accuracy=None
        if result.accuracy is None
        else AccuracyBody(
            position_m=round(result.accuracy.position_m, 5),
            orientation_deg=round(result.accuracy.orientation_deg, 4),
        ),
        confidence=round(result.confidence, 4),
        inliers=result.support.inliers,
        matches=result.support.matches,
        keyframes=[
            KeyframeBody(keyframe=vote.keyframe, matches=vote.matches, inliers=vote.inliers)
            for vote in result.keyframes
            if vote.inliers
        ],
        camera=None if result.camera is None else CameraBody.of(result.camera, result.camera_source),
        narrowed=result.narrowed,
        gravity_checked=result.gravity_checked,
        timings_ms={stage: round(value, 2) for stage, value in result.timings_ms.items()},
        anchors=list(result.anchors),
        vertical=result.vertical,
        axes=frames.axes.name,
        session_from_world=None if session_from_world is None else PoseBody.of(session_from_world),
        hints=list(result.hints),
        shown_matches=None if result.shown_matches is None else ShownMatchesBody.of(result.shown_matches),
        geopose=None if result.geopose is None else GeoPoseBody.of(result.geopose),
        geopose_reason=result.geopose_reason,
        frames=[FrameSupportBody(inliers=each.inliers, matches=each.matches) for each in result.frames],
    )


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def _camera(text: str | None) -> CameraHint | None:
    if text is None or not text.strip():
        return None
    # In quotes where a client has made JSON of a text that was one already.
    if text.lstrip().startswith(("{", "[", '"')):
        value = read_json(text, "camera")
        return _camera(value) if isinstance(value, str) else parse_camera_hint(value)
    return parse_camera_hint(text)


def _gravity(text: str | None, axes: Axes = OPENCV) -> tuple[float, float, float] | None:
    if text is None or not text.strip():
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except (ValueError, OverflowError):
        raise InvalidInputError("gravity must be three numbers, x,y,z in camera axes.") from None
    length = float(np.linalg.norm([x, y, z]))
    if not np.isfinite(length) or length < 1e-6:
        raise InvalidInputError("gravity must have a direction: finite numbers that are not all zero.")
    return axes.direction_in((x, y, z))


def _prior(text: str | None, axes: Axes = OPENCV) -> Prior | None:
    if text is None or not text.strip():
        return None
    value = read_json(text, "prior")
    refuse_unknown_keys(value, known_names(("position", "radius_m")), "prior")
    try:
        position = value["position"]
        refuse_unknown_keys(position, known_names("xyz"), "prior.position")
        numbers = [float(position[axis]) for axis in ("x", "y", "z")]
        radius_m = float(value["radius_m"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InvalidInputError(
            'prior must be {"position": {"x", "y", "z"}, "radius_m"}, all numbers.'
        ) from None
    if not np.isfinite([*numbers, radius_m]).all() or radius_m <= 0:
        raise InvalidInputError("prior must hold finite numbers, with radius_m above zero.")
    return Prior(axes.point_in((numbers[0], numbers[1], numbers[2])), radius_m)
