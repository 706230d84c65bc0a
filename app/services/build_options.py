"""What a build request may ask for, parsed and validated."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from app.errors import InvalidInputError
from app.geometry.camera import MODEL_PARAMETERS, Camera
from app.geometry.se3 import Pose
from app.importers.frames import ScanOptions
from app.vision.keyframes import WANTED_MATCHES, PoseThresholds, thresholds_for_matches
from app.vision.local_features import FEATURE_NAMES

FORMATS = ("auto", "tum", "7scenes")
KEYS = {
    "format", "keyframes", "features", "camera", "depth_scale", "depth_camera", "color_from_depth", "gravity",
    "world_from_scan", "mode", "max_time_difference_s", "refine_depth", "store_images",
}  # fmt: skip
KEYFRAME_KEYS = {"rule", "every", "position_m", "attitude_rad", "thresholds", "wanted_matches"}
MIN_WANTED, MAX_WANTED = 4.0, 5000.0


@dataclass(frozen=True, slots=True)
class KeyframeRule:
    """Which frames become keyframes: `pose` (A 2.1) with its thresholds, or `interval` (every n-th frame).

    With `calibrated` the thresholds are those of the scan itself, at which `wanted_matches` are left.
    """

    rule: Literal["pose", "interval"] = "pose"
    thresholds: PoseThresholds = thresholds_for_matches()
    every: int = 1
    calibrated: bool = False
    wanted_matches: float = WANTED_MATCHES


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """A build's options. `world_from_scan` and `gravity` place the scan; without them its frame is the world."""

    format: str = "auto"
    scan: ScanOptions = ScanOptions()
    keyframes: KeyframeRule = KeyframeRule()
    features: str = "sift"
    gravity: tuple[float, float, float] | None = None
    world_from_scan: Pose | None = None
    mode: Literal["replace", "extend"] = "replace"
    refine_depth: bool = True
    store_images: bool = True


def parse_build_options(values: object) -> BuildOptions:
    """Return the options of a JSON object; raises `InvalidInputError` with a sentence that names the field."""
    if not isinstance(values, Mapping):
        raise InvalidInputError("options must be a JSON object.")
    unknown = sorted(set(values) - KEYS)
    if unknown:
        raise InvalidInputError(
            f"Option {unknown[0]!r} is not known; the options are {', '.join(sorted(KEYS))}."
        )
    return BuildOptions(
        format=_choice(values, "format", FORMATS, "auto"),
        scan=_scan_options(values),
        keyframes=_keyframe_rule(values.get("keyframes")),
        features=_choice(values, "features", FEATURE_NAMES, "sift"),
        gravity=_gravity(values.get("gravity")),
        world_from_scan=_matrix(values.get("world_from_scan"), "world_from_scan"),
        mode=_choice(values, "mode", ("replace", "extend"), "replace"),  # type: ignore[arg-type]
        refine_depth=_flag(values, "refine_depth", True),
        store_images=_flag(values, "store_images", True),
    )


def _scan_options(values: Mapping[str, Any]) -> ScanOptions:
    difference = _number(values.get("max_time_difference_s"), "max_time_difference_s")
    return ScanOptions(
        camera=parse_camera(values.get("camera"), "camera"),
        depth_scale=_number(values.get("depth_scale"), "depth_scale"),
        depth_camera=parse_camera(values.get("depth_camera"), "depth_camera"),
        color_from_depth=_matrix(values.get("color_from_depth"), "color_from_depth"),
        max_time_difference_s=0.02 if difference is None else difference,
    )


def parse_camera(value: object, name: str = "camera") -> Camera | tuple[float, ...] | None:
    """Return the camera of a request: numbers `fx fy cx cy [k1 k2 p1 p2 [k3]]` as a list or text, which get the
    images' size, or an object `{model, width, height, params}`. Raises `InvalidInputError`."""
    if value is None or value == "":
        return None
    if isinstance(value, Mapping):
        return _camera_from_mapping(value, name)
    parts = value.split(",") if isinstance(value, str) else value
    if not isinstance(parts, list | tuple):
        raise InvalidInputError(f"{name} must be numbers fx,fy,cx,cy[,k1,k2,p1,p2[,k3]] or a JSON object.")
    try:
        numbers = tuple(float(part) for part in parts)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError(f"{name} holds something that is not a number.") from None
    if len(numbers) not in (4, 8, 9):
        raise InvalidInputError(
            f"{name} takes 4, 8 or 9 numbers, fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]; got {len(numbers)}."
        )
    if not np.isfinite(numbers).all() or min(numbers[:2]) <= 0:
        raise InvalidInputError(f"{name} must hold finite numbers with focal lengths above zero.")
    return numbers


def _camera_from_mapping(value: Mapping[str, Any], name: str) -> Camera:
    model = value.get("model", "PINHOLE")
    if not isinstance(model, str) or model not in MODEL_PARAMETERS:
        raise InvalidInputError(f"{name}.model must be one of {', '.join(MODEL_PARAMETERS)}.")
    try:
        width, height = int(value["width"]), int(value["height"])
        params = tuple(float(x) for x in value["params"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InvalidInputError(f"{name} needs model, width, height and params (numbers).") from None
    return Camera(model, width, height, params)


def _keyframe_rule(value: object) -> KeyframeRule:
    if value is None:
        return KeyframeRule()
    if not isinstance(value, Mapping):
        raise InvalidInputError('keyframes must be an object such as {"rule": "pose"}.')
    unknown = sorted(set(value) - KEYFRAME_KEYS)
    if unknown:
        raise InvalidInputError(
            f"Option keyframes.{unknown[0]} is not known; there are {', '.join(sorted(KEYFRAME_KEYS))}."
        )
    rule = _choice(value, "rule", ("pose", "interval"), "pose")
    if rule == "interval":
        every = _number(value.get("every", 1), "keyframes.every")
        if every is None or every < 1 or every != int(every):
            raise InvalidInputError("keyframes.every must be a whole number of frames, 1 or more.")
        return KeyframeRule("interval", every=int(every))
    calibrated, wanted = _calibration(value)
    default = thresholds_for_matches()
    position = _number(value.get("position_m"), "keyframes.position_m")
    attitude = _number(value.get("attitude_rad"), "keyframes.attitude_rad")
    thresholds = PoseThresholds(
        default.position_m if position is None else position,
        default.attitude_rad if attitude is None else attitude,
    )
    if min(thresholds.position_m, thresholds.attitude_rad) <= 0:
        raise InvalidInputError("keyframes.position_m and keyframes.attitude_rad must be above zero.")
    return KeyframeRule("pose", thresholds, calibrated=calibrated, wanted_matches=wanted)


def _calibration(value: Mapping[str, Any]) -> tuple[bool, float]:
    """Return whether the thresholds are to be calibrated, and for how many matches."""
    if value.get("thresholds", "calibrated") != "calibrated":
        raise InvalidInputError(
            'keyframes.thresholds takes "calibrated"; numbers go into keyframes.position_m and keyframes.attitude_rad.'
        )
    calibrated = "thresholds" in value
    if calibrated and not {"position_m", "attitude_rad"}.isdisjoint(value):
        raise InvalidInputError(
            "keyframes.thresholds: calibrated thresholds leave no room for position_m or attitude_rad."
        )
    given = _number(value.get("wanted_matches"), "keyframes.wanted_matches")
    return calibrated, check_wanted_matches(WANTED_MATCHES if given is None else given)


def check_wanted_matches(wanted: float) -> float:
    """Return a number of matches that can be asked for; raises `InvalidInputError`."""
    if not MIN_WANTED <= wanted <= MAX_WANTED:
        raise InvalidInputError(
            f"keyframes.wanted_matches must be between {MIN_WANTED:g} and {MAX_WANTED:g}."
        )
    return wanted


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


def _number(value: object, name: str) -> float | None:
    if value is None:
        return None
    # Whole numbers in JSON have no largest one.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InvalidInputError(f"{name} must be a finite number.")
    return float(value)


def _flag(values: Mapping[str, Any], name: str, default: bool) -> bool:
    value = values.get(name, default)
    if not isinstance(value, bool):
        raise InvalidInputError(f"{name} must be true or false.")
    return value


def _choice(values: Mapping[str, Any], name: str, choices: tuple[str, ...], default: str) -> str:
    value = values.get(name, default)
    if value not in choices:
        raise InvalidInputError(f"{name} must be one of {', '.join(choices)}.")
    return str(value)
