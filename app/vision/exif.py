"""What a photo's EXIF says about the camera that took it. Nothing in it is trusted further than it makes sense."""

from __future__ import annotations

import io
import math
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from PIL import Image

from app.vision.images import FORMATS

MAKE, MODEL, EXIF_IFD = 0x010F, 0x0110, 0x8769
FOCAL_LENGTH, PIXEL_X, PIXEL_Y = 0x920A, 0xA002, 0xA003
PLANE_X_RESOLUTION, PLANE_UNIT = 0xA20E, 0xA210
DIGITAL_ZOOM, FOCAL_35MM = 0xA404, 0xA405
# EXIF's resolution units: inch, centimetre, millimetre, micrometre.
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
MAX_NAME = 64
# All that Pillow's reader was seen to raise on damaged tags.
DAMAGE = (
    OSError, SyntaxError, ValueError, EOFError, KeyError, IndexError, TypeError, AttributeError, OverflowError,
    ZeroDivisionError, struct.error, RecursionError,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class PhotoTags:
    """The tags that tell a camera's focal length; None (or an empty name) is what was not there or made no sense.

    `focal_35mm` is the equivalent focal length on 35 mm film, `plane_px_per_mm` the sensor's resolution when the
    photo was taken, `recorded_size` the photo's (width, height) then, as the sensor stood; `digital_zoom` is 1
    without zoom.
    """

    make: str = ""
    model: str = ""
    focal_mm: float | None = None
    focal_35mm: float | None = None
    plane_px_per_mm: float | None = None
    digital_zoom: float = 1.0
    recorded_size: tuple[int, int] | None = None


def read_photo_tags(data: bytes) -> PhotoTags:
    """Return the tags of a JPEG, PNG or WebP file; damaged or impossible ones count as missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                # What stands behind the pixels of a PNG would need them decoded once more.
                raw = image.info.get("exif")
            if not isinstance(raw, bytes):
                return PhotoTags()
            exif = Image.Exif()
            exif.load(raw)
            return _tags(exif, exif.get_ifd(EXIF_IFD))
    except (*DAMAGE, Image.DecompressionBombError):
        return PhotoTags()


def _tags(base: Mapping[int, Any], own: Mapping[int, Any]) -> PhotoTags:
    unit_mm = UNIT_MM.get(_whole(own.get(PLANE_UNIT, 2)) or 0)
    resolution = _number(own.get(PLANE_X_RESOLUTION), 1e-3, 1e9)
    per_mm = None if unit_mm is None or resolution is None else resolution / unit_mm
    size = _whole(own.get(PIXEL_X)), _whole(own.get(PIXEL_Y))
    return PhotoTags(
        make=_text(base.get(MAKE)),
        model=_text(base.get(MODEL)),
        focal_mm=_number(own.get(FOCAL_LENGTH), 0.5, 1000.0),
        focal_35mm=_number(own.get(FOCAL_35MM), 8.0, 1000.0),
        plane_px_per_mm=per_mm,
        digital_zoom=_number(own.get(DIGITAL_ZOOM), 1.0, 100.0) or 1.0,
        recorded_size=None if size[0] is None or size[1] is None else (size[0], size[1]),
    )


def _number(value: object, low: float, high: float) -> float | None:
    """Return a tag as a number within limits. Fractions with a zero below the line are NaN or raise."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except DAMAGE:
        return None
    return number if math.isfinite(number) and low <= number <= high else None


def _whole(value: object) -> int | None:
    number = _number(value, 1, 1e6)
    return None if number is None else int(number)


def _text(value: object) -> str:
    return value.strip("\0 \t\r\n")[:MAX_NAME] if isinstance(value, str) else ""
