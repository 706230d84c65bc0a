"""What a caller may say of a camera: one type, one parser, one JSON form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from app.errors import InvalidCameraError, InvalidInputError
from app.geometry.camera import MODEL_PARAMETERS, Camera

# COLMAP's models that are special cases of others -> the number of their parameters: f cx cy, then coefficients.
SIMPLE_MODELS = {"SIMPLE_PINHOLE": 3, "SIMPLE_RADIAL": 4, "RADIAL": 5, "SIMPLE_RADIAL_FISHEYE": 4}
# How many numbers say a camera without its model: fx fy cx cy [k1 k2 p1 p2 [k3]].
COUNTS = (4, 8, 9)
# Of unknown names, so many and so many characters of each are repeated.
MAX_NAMES = 4
MAX_SHOWN = 40
# No camera's fy is so much smaller than its fx.
MAX_DECIMAL_RATIO = 4
DECIMAL_COMMAS = (
    "{name} must have commas between its numbers and points in them: 525.5,525.5,320,240 for fx,fy,cx,cy."
)
FORMS = "numbers fx,fy,cx,cy[,k1,k2,p1,p2[,k3]] or a JSON object {model, width, height, params}"


@dataclass(frozen=True, slots=True)
class CameraHint:
    """A camera as a caller states it: a whole `Camera`, or only its numbers, which then are for images of any size.

    Exactly one of `camera` and `values` (`fx fy cx cy [k1 k2 p1 p2 [k3]]`) is given.
    """

    camera: Camera | None = None
    values: tuple[float, ...] = ()

    def for_image(self, width: int, height: int) -> Camera:
        """Return the camera of an image of this size: a whole camera is scaled, numbers are taken as they are.

        Raises `InvalidCameraError` when they can't be the image's.
        """
        if self.camera is None:
            return Camera.from_values(self.values, width, height)
        own = self.camera
        if (own.width > own.height) != (width > height) and own.width != own.height:
            raise InvalidCameraError(
                f"The camera is for {own.width} x {own.height} pixels, the upright image has {width} x {height}: give "
                "the intrinsics of the image as its EXIF orientation turns it."
            )
        return own.scaled_to(width, height)

    def to_json(self) -> Any:
        """Return the JSON form that `parse_camera_hint` reads."""
        if self.camera is None:
            return list(self.values)
        own = self.camera
        return {"model": own.model, "width": own.width, "height": own.height, "params": list(own.params)}


def hint_of(camera: Camera) -> CameraHint:
    """Return the hint that states a whole camera."""
    return CameraHint(camera=camera)


def parse_camera_hint(value: object, name: str = "camera") -> CameraHint | None:
    """Return what a request says of a camera, None for nothing.

    `value` is numbers `fx fy cx cy [k1 k2 p1 p2 [k3]]` as a list or text, a calibration matrix, 3x3 or its nine
    numbers, row by row or column by column, or an object `{model, width, height, params}` with one of COLMAP's
    models. Raises `InvalidInputError` and `InvalidCameraError`.
    """
    if value is None or value == "":
        return None
    if isinstance(value, Mapping):
        return CameraHint(camera=_camera_of(value, name))
    parts = _parts(value, name) if isinstance(value, str) else value
    if not isinstance(parts, list | tuple):
        raise InvalidInputError(f"{name} must be {FORMS}.")
    if not isinstance(value, str) and any(isinstance(part, str) for part in parts):
        raise InvalidInputError(f"{name} holds a number as text; it must be {FORMS}.")
    if len(parts) == 3 and all(isinstance(row, list | tuple) and len(row) == 3 for row in parts):
        return CameraHint(values=_values_of_matrix(_numbers([x for row in parts for x in row], name), name))
    numbers = _numbers(parts, name)
    if len(numbers) == 9 and 0.0 in numbers[:2]:
        # The second number of nine is a focal length, or that zero of a matrix which no focal length is.
        return CameraHint(values=_values_of_matrix(numbers, name))
    if len(numbers) not in COUNTS:
        raise InvalidInputError(
            f"{name} takes 4, 8 or 9 numbers, fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]; got {len(numbers)}."
        )
    if not np.isfinite(numbers).all() or min(numbers[:2]) <= 0:
        raise InvalidInputError(f"{name} must hold finite numbers with focal lengths above zero.")
    if min(numbers[2:4]) > 0 and max(numbers[2:4]) < 1:
        raise InvalidInputError(
            f"{name} seems to hold shares of the image's width and height; give pixels: fx and cx times the width, fy "
            "and cy times the height."
        )
    return CameraHint(values=numbers)


def _parts(text: str, name: str) -> list[str]:
    """Return the numbers of a text; raises `InvalidInputError` for commas where points should be."""
    parts = [part.strip() for part in text.split(",")]
    if any(";" in part or len(part.split()) > 1 for part in parts):
        if "," in text:
            raise InvalidInputError(DECIMAL_COMMAS.format(name=name))
        return text.replace(";", " ").split()
    # 525,5,526,1,320,2,240,7: whole numbers, of which each second one is a decimal place.
    are_pairs = len(parts) % 4 == 0 and len(parts) > 4 and all(part.isdecimal() for part in parts)
    if are_pairs and int(parts[1]) < int(parts[0]) / MAX_DECIMAL_RATIO:
        raise InvalidInputError(DECIMAL_COMMAS.format(name=name))
    return parts


def _numbers(parts: list[Any] | tuple[Any, ...], name: str) -> tuple[float, ...]:
    if any(isinstance(part, bool) for part in parts):
        raise InvalidInputError(f"{name} holds true or false in place of a number; it must be {FORMS}.")
    try:
        return tuple(float(part) for part in parts)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError(f"{name} holds something that is not a number; it must be {FORMS}.") from None


def _values_of_matrix(m: tuple[float, ...], name: str) -> tuple[float, ...]:
    """Return fx, fy, cx, cy of a calibration matrix, given row by row or, as ARKit has it, column by column."""
    if m[2:3] + m[5:6] == (0.0, 0.0) and m[6:8] != (0.0, 0.0):
        m = (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])
    if m[3:4] + m[6:8] != (0.0, 0.0, 0.0) or m[8] != 1.0 or not np.isfinite(m).all() or min(m[0], m[4]) <= 0:
        raise InvalidInputError(f"{name} as a 3x3 matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]].")
    if abs(m[1]) > 1e-3 * m[0]:
        raise InvalidInputError(
            f"{name} has a skew of {m[1]:g}, which no camera model here has; it must be 0."
        )
    return m[0], m[4], m[2], m[5]


def _camera_of(value: Mapping[str, Any], name: str) -> Camera:
    model = value.get("model", "PINHOLE")
    counts = {**MODEL_PARAMETERS, **SIMPLE_MODELS}
    if not isinstance(model, str) or model not in counts:
        raise InvalidInputError(f"{name}.model must be one of {', '.join(counts)}.")
    unknown = set(value) - {"model", "width", "height", "params"}
    if unknown:
        raise InvalidInputError(
            f"{name} has no field {_listed(unknown)}: it takes model, width, height, params."
        )
    try:
        width, height = int(_number(value["width"])), int(_number(value["height"]))
        params = tuple(_number(x) for x in value["params"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InvalidInputError(
            f"{name} needs model, width, height and params, all numbers but model."
        ) from None
    if model in SIMPLE_MODELS:
        return _simple_camera(model, width, height, params)
    return Camera(model, width, height, params)


def _listed(names: set[Any]) -> str:
    """Return some unknown names as a sentence may repeat them."""
    return ", ".join(sorted(repr(str(name)[:MAX_SHOWN]) for name in names)[:MAX_NAMES])


def _number(value: object) -> float:
    """Return a JSON number; raises `TypeError` for true, and for a number as text."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError
    return float(value)


def _simple_camera(model: str, width: int, height: int, params: tuple[float, ...]) -> Camera:
    """Return the camera of a model that is a special case of a model here; raises `InvalidCameraError`."""
    if len(params) != SIMPLE_MODELS[model]:
        raise InvalidCameraError(f"{model} takes {SIMPLE_MODELS[model]} parameters, got {len(params)}.")
    f, cx, cy, *coefficients = params
    k1, k2 = (*coefficients, 0.0, 0.0)[:2]
    if model == "SIMPLE_PINHOLE":
        return Camera("PINHOLE", width, height, (f, f, cx, cy))
    target = "OPENCV_FISHEYE" if model == "SIMPLE_RADIAL_FISHEYE" else "OPENCV"
    return Camera(target, width, height, (f, f, cx, cy, k1, k2, 0.0, 0.0))
