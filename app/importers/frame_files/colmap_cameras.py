"""Cameras as COLMAP and formats after it write them."""

from __future__ import annotations

from collections.abc import Sequence

from app.errors import InvalidCameraError, InvalidInputError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import parse_camera_hint

# From the corner of the first pixel, where these principal points count from, to its centre.
CORNER_TO_CENTRE_PX = 0.5
# Models by their numbers in binary files, with how many parameters each has.
MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
)
# Models with one focal length, whose principal point is second.
_ONE_FOCAL_LENGTH = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


def camera_of_colmap(model: str, width: int, height: int, params: Sequence[float], where: str) -> Camera:
    """Return the camera of COLMAP's parameters; raises `InvalidScanError` that names the place `where`."""
    first = 1 if model in _ONE_FOCAL_LENGTH else 2
    moved = [v - CORNER_TO_CENTRE_PX if i in (first, first + 1) else v for i, v in enumerate(params)]
    # Four zeros are no lens that was measured.
    if model == "OPENCV" and len(moved) == dict(MODELS)[model] and not any(moved[4:]):
        model, moved = "PINHOLE", moved[:4]
    if model == "RADIAL_FISHEYE" and len(moved) == dict(MODELS)[model]:
        model, moved = "OPENCV_FISHEYE", [moved[0], *moved, 0.0, 0.0]
    try:
        hint = parse_camera_hint({"model": model, "width": width, "height": height, "params": moved})
    except (InvalidCameraError, InvalidInputError) as error:
        raise InvalidScanError(f"{where}: {error}") from None
    if hint is None or hint.camera is None:
        raise InvalidScanError(f"{where}: the camera can't be read.")
    return hint.camera
