"""Decoding of untrusted image bytes, and measures of an image's quality."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from app.errors import ImageTooLargeError, InvalidImageError, UnsupportedImageError
from app.limits import limit
from app.vision.image_files.formats import (
    DAMAGE,
    FORMATS_IN_WORDS,
    NAMED,
    begun_format,
    name_of_other_format,
    open_image,
)
from app.vision.image_files.orientation import ORIENTATION, UPRIGHT

# Sensors of 10, 12 and 14 bits are written into 16-bit files as they are.
SENSOR_BITS = (8, 10, 12, 14, 16)
# A 16-bit colour file that uses less than this of what 8 bits show was written from a sensor of fewer bits.
DIM_COLOR_VALUE = 128

# Rows of an image that are converted at a time.
STRIP_ROWS = 256

# EXIF orientation -> quarter turns counter-clockwise that make the image upright.
QUARTER_TURNS = {3: 2, 6: 3, 8: 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageOptions:
    """Which images are decoded, and which of them show too little to be used."""

    max_pixels: int = limit(
        50_000_000,
        "An image with more pixels is refused before it is decoded.",
        chosen="By hand: the largest photos of phones' main modes have 50 megapixels, 150 MB when decoded.",
    )
    min_side_px: int = limit(
        32,
        "An image with a shorter side is refused.",
        chosen="By hand: local features need a border of 16 pixels on each side.",
    )
    max_aspect_ratio: float = limit(
        20.0,
        "An image whose longer side is more than this times the shorter one is refused.",
        chosen="By hand: shrunk to what the detectors take, a longer strip would have no width left.",
    )
    quality_side_px: int = limit(
        320,
        "An image's quality is measured after it is shrunk to this longer side.",
        chosen="By hand: sharpness then compares between cameras of different resolution.",
    )
    min_contrast: float = limit(
        4.0,
        "A grey image whose values have a smaller standard deviation (of 255) is poor.",
        chosen="By hand: a lens cap or a plain wall; sensor noise alone is below it.",
    )
    min_brightness: float = limit(
        6.0,
        "A grey image with a smaller mean value (of 255) is poor.",
        chosen="By hand: black but for the sensor's noise.",
    )
    max_brightness: float = limit(
        250.0,
        "A grey image with a larger mean value (of 255) is poor.",
        chosen="By hand: overexposed nearly everywhere.",
    )


OPTIONS = ImageOptions()

Gray = NDArray[np.uint8]
Rgb = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ImageQuality:
    """What decides whether a frame can be used: see `measure_quality`."""

    sharpness: float
    brightness: float
    contrast: float

    @property
    def is_poor(self) -> bool:
        """Whether there is hardly anything to see: black, white or without any structure."""
        lit = OPTIONS.min_brightness <= self.brightness <= OPTIONS.max_brightness
        return not lit or self.contrast < OPTIONS.min_contrast


@dataclass(frozen=True, slots=True)
class Photo:
    """A decoded image file: RGB (height, width, 3), upright, and by how many quarter turns, counter-clockwise, it was
    turned for that; 0 for a mirrored one."""

    rgb: Rgb
    quarter_turns: int


def decode_image(data: bytes, max_pixels: int = OPTIONS.max_pixels) -> Rgb:
    """Return the picture (height, width, 3) of `decode_photo`."""
    return decode_photo(data, max_pixels).rgb


def decode_photo(data: bytes, max_pixels: int = OPTIONS.max_pixels) -> Photo:
    """Decode the bytes of a JPEG, PNG, WebP, HEIC, AVIF or TIFF file to RGB (height, width, 3), upright by its EXIF
    or XMP orientation.

    Format and size are read from the header before anything is decoded. Values of more than 8 bits are scaled from
    the bits that the image uses: 10, 12, 14 or 16. Raises `UnsupportedImageError` that names the format,
    `ImageTooLargeError`, or `InvalidImageError` for bytes that are empty, truncated or corrupt.
    """
    if not data:
        raise InvalidImageError(f"The image is empty; send the bytes of a {FORMATS_IN_WORDS} file.")
    other = name_of_other_format(data[:64])
    if other:
        raise UnsupportedImageError(f"The file is {other}; send {FORMATS_IN_WORDS}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with open_image(io.BytesIO(data)) as image:
                _check_size(image.width, image.height, max_pixels)
                whole = _with_all_bits(image, data)
                turns = QUARTER_TURNS.get(whole.getexif().get(ORIENTATION, UPRIGHT), 0)
                # Not as a copy: an image of 50 megapixels takes 200 MB.
                ImageOps.exif_transpose(whole, in_place=True)
                return Photo(_to_rgb(whole), turns)
    except UnidentifiedImageError:
        raise _unidentified(data) from None
    except Image.DecompressionBombError:
        raise ImageTooLargeError(
            f"The image has more than {max_pixels:,} pixels; send a smaller one."
        ) from None
    except DAMAGE as error:
        if str(error) in NAMED:
            raise UnsupportedImageError(f"The file is {error}; send {FORMATS_IN_WORDS}.") from None
        raise InvalidImageError(f"The image is damaged or cut short ({error}).") from None


def _unidentified(data: bytes) -> InvalidImageError:
    """Return the error of a file that no decoder takes."""
    begun = begun_format(data[:64])
    if begun == "TIFF":
        return UnsupportedImageError(
            "The file is a TIFF of a kind that is not read, or cut short; save it with 8 or 16 bits a colour, or "
            "as JPEG or PNG."
        )
    if begun:
        return InvalidImageError(
            f"The image is damaged or cut short: it begins like {begun} and goes on otherwise."
        )
    return UnsupportedImageError(f"The file is not a {FORMATS_IN_WORDS} image.")


def quarter_turns_of(data: bytes) -> int:
    """Return by how many quarter turns, counter-clockwise, `decode_image` turns an image file upright.

    0 for a mirrored one, and for bytes that can't be read.
    """
    try:
        with open_image(io.BytesIO(data)) as image:
            return QUARTER_TURNS.get(image.getexif().get(ORIENTATION, UPRIGHT), 0)
    except (*DAMAGE, UnidentifiedImageError, Image.DecompressionBombError):
        return 0


def _check_size(width: int, height: int, max_pixels: int) -> None:
    if width * height > max_pixels:
        raise ImageTooLargeError(
            f"The image has {width} x {height} pixels, the limit is {max_pixels:,} in all; send a smaller one."
        )
    if min(width, height) < OPTIONS.min_side_px:
        raise InvalidImageError(
            f"The image has {width} x {height} pixels; each side needs at least {OPTIONS.min_side_px}."
        )
    if max(width, height) > OPTIONS.max_aspect_ratio * min(width, height):
        raise InvalidImageError(
            f"The image has {width} x {height} pixels; one side may be at most {OPTIONS.max_aspect_ratio:g} times "
            "the other."
        )


def _with_all_bits(image: Image.Image, data: bytes) -> Image.Image:
    """Return the image, or, for a 16-bit colour PNG of which Pillow keeps too little, one from all of its bits."""
    if image.format != "PNG" or data[24:25] != b"\x10" or image.mode.startswith("I"):
        return image
    image.load()
    if int(np.asarray(image.convert("RGB")).max()) >= DIM_COLOR_VALUE:
        return image
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    deep = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if deep is None or deep.dtype != np.uint16:
        return image
    bright = Image.fromarray(np.ascontiguousarray(to_8_bits(np.asarray(deep))[..., ::-1]))
    bright.getexif()[ORIENTATION] = image.getexif().get(ORIENTATION, UPRIGHT)
    return bright


def _to_rgb(image: Image.Image) -> Rgb:
    if image.mode.startswith("I") or image.mode == "F":
        return np.repeat(to_8_bits(np.asarray(image))[..., None], 3, axis=2)
    rgb = np.empty((image.height, image.width, 3), np.uint8)
    # In strips, since Pillow makes several copies of what it converts and hands over.
    for top in range(0, image.height, STRIP_ROWS):
        strip = image.crop((0, top, image.width, min(top + STRIP_ROWS, image.height)))
        rgb[top : top + STRIP_ROWS] = np.asarray(strip.convert("RGB"))
    return rgb


def to_8_bits(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image of deep integers or floats as 8 bits.

    Integers are taken for those of the smallest sensor depth (8, 10, 12, 14 or 16 bits) that holds them; floats up
    to 1 for shares of white, others as integers. Below zero and what is not finite become black.
    """
    finite = np.where(np.isfinite(values) & (values > 0), values, 0)
    largest = float(finite.max())
    if values.dtype.kind == "f" and largest <= 1.0:
        return (finite * 255.0).astype(np.uint8)
    used = int(largest).bit_length()
    bits = next((bits for bits in SENSOR_BITS if used <= bits), used)
    # Not by float arithmetic where integers do: 16 bits keep their upper byte as it is.
    return (finite.astype(np.int64) >> (bits - 8)).astype(np.uint8)


def to_gray(rgb: Rgb) -> Gray:
    """Return the luma (height, width) of an RGB image."""
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def shrink(image: NDArray[np.uint8], max_side_px: int) -> tuple[NDArray[np.uint8], float]:
    """Return the image with its longer side at most `max_side_px`, and the scale (<= 1) that was applied.

    With pixel centres on integers a point `p` of the result lies at `(p + 0.5) / scale - 0.5` of the input.
    """
    height, width = image.shape[:2]
    scale = max_side_px / max(height, width)
    if scale >= 1.0:
        return image, 1.0
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), scale


def measure_quality(gray: Gray) -> ImageQuality:
    """Measure a grey image (height, width), independent of its resolution above `quality_side_px`.

    `sharpness` is the variance of the Laplacian over the variance of the image (small: blurred), `brightness`
    the mean grey value, `contrast` its standard deviation.
    """
    small, _ = shrink(gray, OPTIONS.quality_side_px)
    values = small.astype(np.float32)
    contrast = float(values.std())
    laplacian = cv2.Laplacian(cv2.GaussianBlur(values, (3, 3), 0), cv2.CV_32F)
    sharpness = float(laplacian.var()) / max(contrast**2, 1.0)
    return ImageQuality(sharpness, float(values.mean()), contrast)
