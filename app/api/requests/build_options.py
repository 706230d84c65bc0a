"""The options of a build as OpenAPI shows them; `parse_build_options` of the engine reads and checks them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Annotated, Literal

from fastapi import Form
from pydantic import BaseModel, ConfigDict, Field

from app.api.requests.described import GivenCamera
from app.api.requests.json_text import JsonTextOf
from app.api.requests.names import Known, refuse_unknown_keys
from app.api.requests.read_json import read_json
from app.engine.mapping.keyframe_rule import KEYS as KEYFRAME_KEYS
from app.engine.mapping.options import ESTIMATE, FORMATS, KEYS
from app.importers.conventions import AXES_NAMES, DIRECTIONS, OWN_AXES, QUATERNION_ORDERS
from app.vision.local_features import FEATURE_NAMES

CAMERA = "fx, fy, cx, cy[, k1, k2, p1, p2[, k3]] as a list, or {model, width, height, params}"
Camera = list[float] | GivenCamera | str
Matrix = list[list[float]]


class KeyframesOption(BaseModel):
    """Which frames become keyframes; each rule takes the keys that its line names."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"rule": "pose", "position_m": 0.1757, "attitude_rad": 0.1304}},
    )

    rule: str = Field("pose", json_schema_extra={"enum": list(KEYFRAME_KEYS)})
    position_m: float | None = Field(None, description="Rule pose: least position difference of keyframes")
    attitude_rad: float | None = Field(None, description="Rule pose: least attitude difference of keyframes")
    thresholds: Literal["calibrated"] | None = Field(
        None, description="Rule pose: both thresholds are fitted to the scan"
    )
    wanted_matches: float | None = Field(
        None, description="Rule pose, calibrated: matches that a frame must share with its nearest keyframe"
    )
    alpha: float | None = Field(None, description="Rule content: largest similarity to the last keyframe")
    beta: float | None = Field(None, description="Rule content: largest similarity to the one before it")
    combine: Literal["and", "or"] | None = Field(
        None, description="Rule content: whether both similarities must be small, or one"
    )
    seen: Literal["skip", "join"] | None = Field(
        None, description="Rule content: what becomes of a frame whose place was seen earlier"
    )
    steady: bool | None = Field(None, description="Rule content: blurred frames are left out")
    every_m: float | None = Field(None, description="Rule distance: metres between keyframes")
    every: int | None = Field(None, description="Rule interval: frames from one keyframe to the next")


Pixel = Annotated[list[float], Field(min_length=2, max_length=2)]


class PlanPlaceOption(BaseModel):
    """A point on the plan: where the camera stood at a frame, or what a pixel of the frame shows."""

    model_config = ConfigDict(extra="forbid")

    frame: str | float = Field(description="A photo's or frame's name, or seconds since a video's start")
    plan: Pixel = Field(description="x and y on the plan in metres")
    pixel: Pixel | None = Field(None, description="u and v; without it the place is the camera's own")


class ScaleOption(BaseModel):
    """The scale of pictures without poses: distance_m with frame and pixels, or one of the others."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"marker_m": 0.16}})

    distance_m: float | None = Field(None, description="Between what two pixels of a frame show")
    frame: str | float | None = Field(
        None, description="Of distance_m: a photo's or frame's name, or seconds since a video's start"
    )
    pixels: list[Pixel] | None = Field(None, description="Of distance_m: two pixels, u and v each")
    marker_m: float | None = Field(None, description="Side of printed markers that are in view")
    camera_height_m: float | None = Field(
        None, description="Height of the camera above a floor that is in view"
    )
    correspondences: list[PlanPlaceOption] | None = Field(
        None, description="Three or more places on the plan"
    )


class BuildOptionsBody(BaseModel):
    """Options of a build; all may be left out."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "format": "tum",
                "camera": [525.5, 525.5, 320, 240],
                "depth_scale": 1000,
                "gravity": [0, 0, -1],
                "keyframes": {"rule": "pose", "position_m": 0.1757, "attitude_rad": 0.1304},
                "mode": "replace",
            }
        },
    )

    format: str = Field(
        "auto", description="Form of the scan; auto finds it", json_schema_extra={"enum": list(FORMATS)}
    )
    camera: Camera | None = Field(
        None, description=f"Intrinsics of the colour images: {CAMERA}; else from the files"
    )
    depth_scale: float | None = Field(None, description="Depth units per metre; else from the files")
    depth_camera: Camera | None = Field(
        None, description="Intrinsics of the depth images where they differ from the colour images'"
    )
    color_from_depth: Matrix | None = Field(
        None, description="4x4 that moves points of the depth camera to the colour camera"
    )
    max_time_difference_s: float = Field(
        0.02, description="How far apart the times of colour, depth and pose may be"
    )
    keyframes: KeyframesOption | None = Field(None, description="The rule that selects keyframes")
    features: str = Field(
        "sift", description="Local features of the map", json_schema_extra={"enum": list(FEATURE_NAMES)}
    )
    gravity: list[float] | None = Field(
        None, description="Direction of down in the scan's frame, [x, y, z]; the world's z then points up"
    )
    world_from_scan: Matrix | None = Field(
        None, description="4x4 that moves the scan into the venue's world; else the scan is registered"
    )
    mode: Literal["replace", "extend"] = Field("replace", description="What becomes of the venue's map")
    refine_depth: bool = Field(True, description="Triangulate points with the scan's other frames")
    second_features: bool = Field(
        True,
        description="Keep XFeat's features of each keyframe too, for frames in which the others find too little",
    )
    store_images: bool = Field(
        True, description="Keep the pictures of keyframes; without them a keyframe takes at most 100 kB"
    )
    blur_faces: bool = Field(False, description="Blur the faces in the keyframes' pictures that are kept")
    max_features_per_keyframe: int | None = Field(
        None, description="Number of features to keep of each keyframe, 50 or more"
    )
    repair: bool = Field(
        False, description="Let the examination change how the scan is read where the cause is beyond doubt"
    )
    force: bool = Field(False, description="Replace a map that contradicts the new one")
    axes: str = Field(
        OWN_AXES,
        description=f"Where the camera's x, y and z point in the poses: {', '.join(AXES_NAMES)}, or three letters "
        "such as rdf (right, down, forward)",
    )
    poses: str = Field(
        "world_from_camera",
        description="Direction of the transforms in the files, or estimate: poses are estimated from the pictures",
        json_schema_extra={"enum": [*DIRECTIONS, ESTIMATE]},
    )
    quaternion: str = Field(
        "xyzw",
        description="Order of the quaternions in the files",
        json_schema_extra={"enum": list(QUATERNION_ORDERS)},
    )
    rotate_deg: Literal[0, 90, 180, 270] = Field(
        0, description="By how much the pictures were turned counter-clockwise from the camera of the poses"
    )
    mount_deg: list[float] | None = Field(
        None,
        description="[x, y, z]: rotation vector in degrees, about the camera's axes, of a camera that is mounted at an "
        "angle to the body of the poses",
    )
    time_offset_s: float = Field(
        0.0, description="The pose of a picture is that of its time plus this; at most an hour"
    )
    position_scale: float = Field(1.0, description="Units per metre of the positions in the poses")
    scale: ScaleOption | None = Field(
        None, description="What is known of the size of pictures without poses, in one of four ways"
    )
    swap_depth_bytes: bool = Field(False, description="Exchange the two bytes of each depth value")
    depth_along_rays: bool = Field(
        False, description="Depth is the distance along the ray, not along the optical axis"
    )
    depth_shift_px: list[int] | None = Field(
        None, description="[right, down]: pixels by which depth is moved over the colour image"
    )
    start: list[float] | None = Field(
        None,
        description="Uniform motion, for a scan without poses: start x, y and the camera's height z in metres",
    )
    speed_m_s: float | None = Field(None, description="Uniform motion: speed")
    direction_deg: float | None = Field(
        None, description="Uniform motion: direction, counter-clockwise from x"
    )
    fps: float | None = Field(None, description="Uniform motion: frames per second")


OptionsField = Annotated[
    str,
    Form(
        description="JSON, e.g. " + json.dumps({"format": "tum", "depth_scale": 1000, "gravity": [0, 0, -1]})
    ),
    JsonTextOf(BuildOptionsBody),
]


def read_options(text: str) -> object:
    """Return the JSON of the form field `options`; its values are checked by `parse_build_options`.

    Raises `InvalidInputError` for text that is not JSON, and for unknown keys.
    """
    values = read_json(text, "options")
    refuse_unknown_keys(values, _known(BuildOptionsBody, sorted(KEYS)), "options")
    if isinstance(values, dict):
        keys = ("rule", *(key for keys in KEYFRAME_KEYS.values() for key in keys))
        refuse_unknown_keys(values.get("keyframes"), _known(KeyframesOption, keys), "options.keyframes")
    return values


def _known(model: type[BaseModel], keys: Iterable[str]) -> dict[str, Known]:
    """Return what the parser takes, with the descriptions of a model."""
    fields = model.model_fields
    return {key: Known(key, (fields[key].description or "") if key in fields else "") for key in keys}
