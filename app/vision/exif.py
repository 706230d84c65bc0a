"""What a photo's EXIF says about the camera that took it. Nothing in it is trusted further than it makes sense."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from PIL import Image

from app.limits import limit
from app.vision.image_files.formats import DAMAGE, open_image
from app.vision.image_files.orientation import load_all_metadata

# EXIF 2.32, sections 4.6.4 and 4.6.5: the numbers of the tags.
MAKE = 0x010F
MODEL = 0x0110
EXIF_IFD = 0x8769
FOCAL_LENGTH = 0x920A
PIXEL_X = 0xA002
PIXEL_Y = 0xA003
PLANE_X_RESOLUTION = 0xA20E
PLANE_UNIT = 0xA210
DIGITAL_ZOOM = 0xA404
FOCAL_35MM = 0xA405
# EXIF's resolution units: inch, centimetre, millimetre, micrometre.
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
INCH = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class TagOptions:
    """Outside of these a tag makes no sense and counts as missing."""

    min_focal_mm: float = limit(
        0.5, "The shortest focal length that is believed.", chosen="By hand: shorter than any phone's."
    )
    max_focal_mm: float = limit(
        1000.0, "The longest focal length that is believed.", chosen="By hand: longer than any lens indoors."
    )
    min_focal_35mm: float = limit(
        8.0, "The shortest 35 mm equivalent that is believed.", chosen="By hand: a fisheye lens has 8 mm."
    )
    max_digital_zoom: float = limit(
        100.0, "The largest digital zoom that is believed.", chosen="By hand: phones offer up to 100 times."
    )
    max_size_px: float = limit(
        1e6, "The longest side of a photo that is believed.", chosen="By hand: past any sensor."
    )
    max_name_characters: int = limit(
        64, "Names of makers and models are cut to this.", chosen="By hand: the longest listed phone has 24."
    )


OPTIONS = TagOptions()
# Damaged rationals reach both ends of what a float holds.
_MIN_RESOLUTION = 1e-3
_MAX_RESOLUTION = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoTags:
    """The tags that state a camera's focal length; None (or an empty name) is what was not there or made no sense.

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
    """Return the tags of an image file; damaged or impossible ones count as missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = io.BytesIO(data)
            with open_image(file) as image:
                load_all_metadata(image, file)
                # Pillow's own method for PNG decodes every image that has no EXIF data in its header.
                exif = Image.Image.getexif(image)
                return _tags(exif, exif.get_ifd(EXIF_IFD))
    except (*DAMAGE, RecursionError, Image.DecompressionBombError):
        return PhotoTags()


def _tags(base: Mapping[int, Any], own: Mapping[int, Any]) -> PhotoTags:
    unit_mm = UNIT_MM.get(_whole(own.get(PLANE_UNIT, INCH)) or 0)
    resolution = _number(own.get(PLANE_X_RESOLUTION), _MIN_RESOLUTION, _MAX_RESOLUTION)
    per_mm = None if unit_mm is None or resolution is None else resolution / unit_mm
    size = _whole(own.get(PIXEL_X)), _whole(own.get(PIXEL_Y))
    return PhotoTags(
        make=_text(base.get(MAKE)),
        model=_text(base.get(MODEL)),
        focal_mm=_number(own.get(FOCAL_LENGTH), OPTIONS.min_focal_mm, OPTIONS.max_focal_mm),
        focal_35mm=_number(own.get(FOCAL_35MM), OPTIONS.min_focal_35mm, OPTIONS.max_focal_mm),
        plane_px_per_mm=per_mm,
        digital_zoom=_number(own.get(DIGITAL_ZOOM), 1.0, OPTIONS.max_digital_zoom) or 1.0,
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
    number = _number(value, 1, OPTIONS.max_size_px)
    return None if number is None else int(number)


def _text(value: object) -> str:
    return value.strip("\0 \t\r\n")[: OPTIONS.max_name_characters] if isinstance(value, str) else ""
