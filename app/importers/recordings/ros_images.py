"""Images in ROS messages, written to files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.importers.unpacked import FrameFiles

# Encoding -> type of a value, values a pixel, and what brings a picture to BGR.
_COLOR: dict[str, tuple[str, int, int | None]] = {
    "rgb8": ("u1", 3, cv2.COLOR_RGB2BGR),
    "bgr8": ("u1", 3, None),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2BGR),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2BGR),
    "8UC3": ("u1", 3, None),
    "mono8": ("u1", 1, None),
    "yuv422": ("u1", 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": ("u1", 2, cv2.COLOR_YUV2BGR_YUY2),
}
_DEPTH = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
# What compressed_depth_image_transport puts before the PNG: a format and two floats.
_COMPRESSED_DEPTH_HEADER_BYTES = 12


def is_depth(message: Any) -> bool:
    """Whether a message holds depth in an encoding that is read."""
    if hasattr(message, "encoding"):
        return message.encoding in _DEPTH
    return "depth" in message.format.lower() or "16UC1" in message.format


def picture_of(message: Any, files: FrameFiles, name: str) -> Path:
    """Write a colour image and return its file: as it is compressed, else as JPEG.

    Raises `InvalidScanError` for an encoding that is not read and for data of another size.
    """
    if not hasattr(message, "encoding"):
        data = bytes(message.data)
        return files.write(f"{name}{'.png' if data.startswith(b'PNG', 1) else '.jpg'}", data)
    if message.encoding not in _COLOR:
        raise InvalidScanError(
            f"The bag's colour is encoded as {message.encoding}; {', '.join(_COLOR)} are read."
        )
    kind, channels, conversion = _COLOR[message.encoding]
    picture: NDArray[Any] = _pixels(message, kind, channels)
    if conversion is not None:
        picture = cv2.cvtColor(picture, conversion)
    return files.write_picture(f"{name}.jpg", picture)


def depth_of(message: Any, files: FrameFiles, name: str) -> Path:
    """Write a depth image in millimetres and return its file; raises `InvalidScanError` as `picture_of`."""
    if hasattr(message, "encoding"):
        kind = _DEPTH[message.encoding]
        raw = _pixels(message, kind, 1)
        if kind == "f4":
            return files.write_depth_m(f"{name}.png", raw.astype(np.float32))
        return files.write_depth(f"{name}.png", raw.astype(np.uint16))
    data = np.frombuffer(bytes(message.data), np.uint8)
    image = cv2.imdecode(data[_COMPRESSED_DEPTH_HEADER_BYTES:], cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16:
        raise InvalidScanError("The bag's compressed depth is not a PNG of 16 bits.")
    return files.write_depth(f"{name}.png", np.asarray(image, dtype=np.uint16))


def _pixels(message: Any, kind: str, channels: int) -> NDArray[np.generic]:
    """Return the values (height, width[, channels]) of a message, whose rows may be longer than the image is wide."""
    dtype = np.dtype(("<", ">")[bool(message.is_bigendian)] + kind)
    row_bytes = message.width * channels * dtype.itemsize
    data = np.frombuffer(bytes(message.data), np.uint8)
    if message.step < row_bytes or len(data) != message.step * message.height or not row_bytes:
        raise InvalidScanError("An image of the bag is damaged: its data is not of the size that it states.")
    rows = np.ascontiguousarray(data.reshape(message.height, message.step)[:, :row_bytes])
    values = rows.view(dtype).reshape(message.height, message.width, channels)
    return values[..., 0] if channels == 1 else values
