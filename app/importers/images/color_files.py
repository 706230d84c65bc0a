"""Colour images of a scan, by their headers."""

from __future__ import annotations

import warnings
from pathlib import Path

from PIL import Image

from app.errors import InvalidScanError
from app.importers.images.depth_files import LIMITS
from app.vision.image_files.formats import (
    DAMAGE,
    FORMATS_IN_WORDS,
    RAW_PHOTO,
    TEXT,
    name_of_other_format,
    open_image,
)
from app.vision.image_files.orientation import UPRIGHT, stored_orientation

_NEEDED = f"colour images of a scan must be {FORMATS_IN_WORDS}"


def color_size(path: Path) -> tuple[int, int] | None:
    """Return (width, height) of a colour image from its header, None if it can't be read.

    Raises `InvalidScanError` for a format that is not read, for more pixels than the limit, and for an image that
    its EXIF or XMP data says to rotate: its pixels would no longer lie where the depth image and the camera have
    them.
    """
    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")
            _check_format(path, file.read(64))
            file.seek(0)
            with open_image(file) as image:
                size = image.size
                _check_pixels(path, size)
                orientation = stored_orientation(image, file)
    except Image.DecompressionBombError:
        raise InvalidScanError(f"{path.name} has too many pixels: {LIMITS.in_words}.") from None
    except InvalidScanError:
        raise
    except DAMAGE as error:
        if str(error) == RAW_PHOTO:
            raise InvalidScanError(f"{path.name} is {RAW_PHOTO}; {_NEEDED}.") from None
        return None
    if orientation != UPRIGHT:
        raise InvalidScanError(
            f"{path.name} has an EXIF rotation (orientation {orientation}), so that its pixels don't lie as those of "
            "the depth image: save the scan's images without a rotation."
        )
    return size


def _check_format(path: Path, head: bytes) -> None:
    other = name_of_other_format(head)
    # Text in place of one picture is a damaged file, which is left out as others are.
    if other and other != TEXT:
        raise InvalidScanError(f"{path.name} is {other}; {_NEEDED}.")


def _check_pixels(path: Path, size: tuple[int, int]) -> None:
    if size[0] * size[1] > LIMITS.max_pixels:
        raise InvalidScanError(f"{path.name} has {size[0]} x {size[1]} pixels; {LIMITS.in_words}.")
