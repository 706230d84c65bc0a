"""Decoding of untrusted image bytes, and measures of an image's quality."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from app.errors import ImageTooLargeError, InvalidImageError, UnsupportedImageError

FORMATS = ("JPEG", "PNG", "WEBP")
MAX_PIXELS = 50_000_000
MIN_SIDE_PX = 32
# Shrunk to what the detectors take, a longer strip would have no width left.
MAX_ASPECT = 20

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
        return self.contrast < 4.0 or self.brightness < 6.0 or self.brightness > 250.0


def decode_image(data: bytes, max_pixels: int = MAX_PIXELS) -> Rgb:
    """Decode JPEG, PNG or WebP bytes to RGB (height, width, 3), upright by its EXIF orientation.

    Format and size are read from the header before anything is decoded. Raises `UnsupportedImageError`,
    `ImageTooLargeError`, or `InvalidImageError` for bytes that are empty, truncated or corrupt.
    """
    if not data:
        raise InvalidImageError("The image is empty; send the bytes of a JPEG, PNG or WebP file.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                _check_size(image.width, image.height, max_pixels)
                return _to_rgb(ImageOps.exif_transpose(image))
    except UnidentifiedImageError:
        raise UnsupportedImageError("The file is not a JPEG, PNG or WebP image.") from None
    except Image.DecompressionBombError:
        raise ImageTooLargeError(
            f"The image has more than {max_pixels:,} pixels; send a smaller one."
        ) from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise InvalidImageError(f"The image is damaged or cut short ({error}).") from None


def _check_size(width: int, height: int, max_pixels: int) -> None:
    if width * height > max_pixels:
        raise ImageTooLargeError(
            f"The image has {width} x {height} pixels, the limit is {max_pixels:,} in all; send a smaller one."
        )
    if min(width, height) < MIN_SIDE_PX:
        raise InvalidImageError(
            f"The image has {width} x {height} pixels; each side needs at least {MIN_SIDE_PX}."
        )
    if max(width, height) > MAX_ASPECT * min(width, height):
        raise InvalidImageError(
            f"The image has {width} x {height} pixels; one side may be at most {MAX_ASPECT} times the other."
        )


def _to_rgb(image: Image.Image) -> Rgb:
    if image.mode.startswith("I;16") or image.mode == "I":
        return cv2.cvtColor((np.asarray(image) >> 8).astype(np.uint8), cv2.COLOR_GRAY2RGB).astype(np.uint8)
    return np.asarray(image.convert("RGB"))


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
    """Measure a grey image (height, width), independent of its resolution above 320 pixels.

    `sharpness` is the variance of the Laplacian over the variance of the image (small: blurred), `brightness`
    the mean grey value, `contrast` its standard deviation.
    """
    small, _ = shrink(gray, 320)
    values = small.astype(np.float32)
    contrast = float(values.std())
    laplacian = cv2.Laplacian(cv2.GaussianBlur(values, (3, 3), 0), cv2.CV_32F)
    sharpness = float(laplacian.var()) / max(contrast**2, 1.0)
    return ImageQuality(sharpness, float(values.mean()), contrast)
