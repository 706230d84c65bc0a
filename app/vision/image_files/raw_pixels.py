"""Pixels without a file around them become one."""

from __future__ import annotations

import cv2
import numpy as np

from app.errors import InvalidImageError

# Fast rather than small: the file is read again at once.
PNG_LEVEL = 1


def png_of_pixels(pixels: bytes, width: int, height: int) -> bytes:
    """Return a PNG of 8-bit pixels, row by row from the upper left: gray, or red, green, blue, alpha, as their number
    says. Raises `InvalidImageError` for another number of bytes."""
    count, channels = width * height, 0 if width * height <= 0 else len(pixels) / (width * height)
    if channels not in (1, 4):
        raise InvalidImageError(
            f"{len(pixels):,} bytes are no {width} x {height} pixels of GRAY8 ({count:,} bytes) or RGBA32."
        )
    image = np.frombuffer(pixels, dtype=np.uint8).reshape(height, width, int(channels))
    if channels == 4:
        # Blue, green, red, as OpenCV writes them; the alpha of a camera's picture means nothing.
        image = image[..., [2, 1, 0]]
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])[1].tobytes()
