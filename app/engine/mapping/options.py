"""What a build request may ask for, parsed and validated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from app.engine.mapping.keyframe_rule import KeyframeRule, parse_keyframe_rule
from app.engine.mapping.option_values import choice as _choice
from app.engine.mapping.option_values import count as _count
from app.engine.mapping.option_values import flag as _flag
from app.engine.mapping.option_values import number as _number
from app.engine.mapping.structure.scale_options import Scale, parse_scale
from app.errors import InvalidInputError
from app.geometry.camera_hint import parse_camera_hint
from app.geometry.se3 import Pose
from app.geometry.uniform_motion import UniformMotion
from app.importers.conventions import (
    AXES_NAMES,
    DIRECTIONS,
    OWN_AXES,
    QUATERNION_ORDERS,
    PoseConvention,
    parse_axes,
)
from app.importers.frames import ScanOptions
from app.vision.local_features import FEATURE_NAMES, check_features

# With fewer, hardly any pose passes its checks.
MIN_FEATURES_PER_KEYFRAME = 50
FORMATS = (
    "auto", "tum", "12scenes", "7scenes", "nerfstudio", "polycam", "scannet", "redwood", "stray-scanner", "record3d",
    "3d-scanner-app", "arkitscenes", "sens", "rtabmap", "rtabmap-export", "ros-bag", "kapture", "colmap",
    "video", "images", "recording",
)  # fmt: skip
# What `poses` says to have them estimated from the pictures.
ESTIMATE = "estimate"
MOTION_KEYS = ("start", "speed_m_s", "direction_deg", "fps")
KEYS = {
    "format", "keyframes", "features", "camera", "depth_scale", "depth_camera", "color_from_depth", "gravity",
    "world_from_scan", "mode", "max_time_difference_s", "refine_depth", "second_features", "store_images",
    "blur_faces", "max_features_per_keyframe", "repair", "force", "axes", "poses", "quaternion", "rotate_deg",
    "mount_deg", "time_offset_s", "position_scale", "scale", "swap_depth_bytes", "depth_along_rays", "depth_shift_px",
    *MOTION_KEYS,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildOptions:
    """A build's options. `world_from_scan` and `gravity` place the scan; without them its frame is the world.

    Without `max_features_per_keyframe` a map with pictures keeps all features, one without as many as its size
    allows (`app.engine.mapping.sparse_map`). `gravity` is in the frame of the poses as they are read. `repair` lets
    the examination change how the scan is read where that is beyond doubt; `second_features` are kept, in maps with
    pictures, for frames in which the own ones find too little; `force` replaces a map that contradicts the new one.
    `scale` is what is known of the size of a scan whose poses are estimated.
    """

    format: str = "auto"
    scan: ScanOptions = ScanOptions()
    keyframes: KeyframeRule = KeyframeRule()
    features: str = "sift"
    gravity: tuple[float, float, float] | None = None
    world_from_scan: Pose | None = None
    mode: Literal["replace", "extend"] = "replace"
    refine_depth: bool = True
    second_features: bool = True
    store_images: bool = True
    blur_faces: bool = False
    max_features_per_keyframe: int | None = None
    repair: bool = False
    force: bool = False
    scale: Scale | None = None


def parse_build_options(values: object) -> BuildOptions:
    """Return the options of a JSON object; raises `InvalidInputError` with a sentence that names the field."""
    if not isinstance(values, Mapping):
        raise InvalidInputError("options must be a JSON object.")
    unknown = sorted(set(values) - KEYS)
    if unknown:
        raise InvalidInputError(
            f"Option {unknown[0]!r} is not known; the options are {', '.join(sorted(KEYS))}."
        )
    scan = _scan_options(values)
    gravity = _gravity(values.get("gravity"))
    return BuildOptions(
        format=_choice(values, "format", FORMATS, "auto"),
        scan=scan,
        keyframes=parse_keyframe_rule(values.get("keyframes")),
        features=check_features(_choice(values, "features", FEATURE_NAMES, "sift")),
        gravity=None if gravity is None else scan.convention.direction_in_own(gravity),
        world_from_scan=_matrix(values.get("world_from_scan"), "world_from_scan"),
        mode=_choice(values, "mode", ("replace", "extend"), "replace"),  # type: ignore[arg-type]
        refine_depth=_flag(values, "refine_depth", True),
        second_features=_flag(values, "second_features", True),
        store_images=_flag(values, "store_images", True),
        blur_faces=_flag(values, "blur_faces", False),
        max_features_per_keyframe=_max_features(values.get("max_features_per_keyframe")),
        repair=_flag(values, "repair", False),
        force=_flag(values, "force", False),
        scale=parse_scale(values.get("scale")),
    )


def _scan_options(values: Mapping[str, Any]) -> ScanOptions:
    difference = _number(values.get("max_time_difference_s"), "max_time_difference_s")
    return ScanOptions(
        camera=parse_camera_hint(values.get("camera"), "camera"),
        depth_scale=_number(values.get("depth_scale"), "depth_scale"),
        depth_camera=parse_camera_hint(values.get("depth_camera"), "depth_camera"),
        color_from_depth=_matrix(values.get("color_from_depth"), "color_from_depth"),
        max_time_difference_s=0.02 if difference is None else difference,
        motion=_motion(values),
        estimate_poses=values.get("poses") == ESTIMATE,
        convention=_convention(values),
        swap_depth_bytes=_flag(values, "swap_depth_bytes", False),
        depth_along_rays=_flag(values, "depth_along_rays", False),
        depth_shift_px=_shift(values.get("depth_shift_px")),
    )


def _convention(values: Mapping[str, Any]) -> PoseConvention:
    """Return how the scan's poses are written, as far as the options say."""
    axes = values.get("axes", OWN_AXES)
    if not isinstance(axes, str):
        raise InvalidInputError(
            f"axes must be a name: {', '.join(AXES_NAMES)}, or three letters such as rdf."
        )
    rotate = _number(values.get("rotate_deg"), "rotate_deg") or 0.0
    offset_s = _number(values.get("time_offset_s"), "time_offset_s")
    scale = _number(values.get("position_scale"), "position_scale")
    poses = _choice(values, "poses", (*DIRECTIONS, ESTIMATE), "world_from_camera")
    return PoseConvention(
        axes=parse_axes(axes),
        poses="world_from_camera" if poses == ESTIMATE else poses,  # type: ignore[arg-type]
        quaternion=_choice(values, "quaternion", QUATERNION_ORDERS, "xyzw"),  # type: ignore[arg-type]
        rotate_deg=int(rotate) if rotate == int(rotate) else -1,
        time_offset_s=0.0 if offset_s is None else offset_s,
        position_scale=1.0 if scale is None else scale,
        mount_deg=_mount(values.get("mount_deg")),
    )


def _mount(value: object) -> tuple[float, float, float]:
    if value is None:
        return 0.0, 0.0, 0.0
    given = value if isinstance(value, list | tuple) and len(value) == 3 else (None, None, None)
    x, y, z = (_number(part, "mount_deg") for part in given)
    if x is None or y is None or z is None:
        raise InvalidInputError("mount_deg must be three numbers: the camera's rotation vector in degrees.")
    return x, y, z


def _shift(value: object) -> tuple[int, int]:
    if value is None:
        return 0, 0
    right, down = (
        (_number(part, "depth_shift_px") for part in value)
        if isinstance(value, list | tuple) and len(value) == 2
        else (None, None)
    )
    if right is None or down is None or right != int(right) or down != int(down):
        raise InvalidInputError(
            "depth_shift_px must be two whole numbers: pixels by which depth is moved to the right and down."
        )
    return int(right), int(down)


def _motion(values: Mapping[str, Any]) -> UniformMotion | None:
    """Return the uniform motion that the options state, all four of them or none."""
    given = [key for key in MOTION_KEYS if values.get(key) is not None]
    if not given:
        return None
    missing = [key for key in MOTION_KEYS if key not in given]
    if missing:
        raise InvalidInputError(f"{given[0]} is part of a uniform motion, which needs {missing[0]} too.")
    if values.get("gravity") is not None:
        raise InvalidInputError("gravity must be left out with a uniform motion, whose frame stands upright.")
    start = values["start"]
    if not isinstance(start, list | tuple) or len(start) != 3:
        raise InvalidInputError("start must be three numbers, x, y and the camera's height z in metres.")
    x, y, z, speed, direction, fps = (
        _required(value, name)
        for value, name in zip(
            [*start, *(values[key] for key in MOTION_KEYS[1:])],
            ("start", "start", "start", *MOTION_KEYS[1:]),
            strict=True,
        )
    )
    return UniformMotion((x, y, z), speed, direction, fps)


def _required(value: object, name: str) -> float:
    given = _number(value, name)
    if given is None:
        raise InvalidInputError(f"{name} must hold numbers.")
    return given


def _max_features(value: object) -> int | None:
    if value is None:
        return None
    return _count(value, "max_features_per_keyframe", MIN_FEATURES_PER_KEYFRAME, "features")


def _gravity(value: object) -> tuple[float, float, float] | None:
    if value is None:
        return None
    vector = np.asarray(value if isinstance(value, list | tuple) else [], dtype=object)
    try:
        x, y, z = (float(v) for v in vector)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError(
            "gravity must be three numbers, the direction of down in the scan's frame."
        ) from None
    length = float(np.linalg.norm([x, y, z]))
    if not np.isfinite(length) or length < 1e-6:
        raise InvalidInputError("gravity must have a direction: three finite numbers that are not all zero.")
    return x, y, z


def _matrix(value: object, name: str) -> Pose | None:
    if value is None:
        return None
    try:
        return Pose.from_matrix(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError(f"{name} must be a 4x4 matrix: four rows of four numbers.") from None
