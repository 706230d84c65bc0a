"""Images in ROS messages, written to files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.importers.images.depth_files import LIMITS
from app.importers.images.rvl import decode_rvl
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
# What compressed_depth_image_transport puts before its data, and what is before the data of RVL.
_HEADER = struct.Struct("<i2f")
_RVL_SIZE = struct.Struct("<2I")
_PNG = b"\x89PNG"


def is_depth(message: Any) -> bool:
    """Whether a message holds depth in an encoding that is read."""
    if hasattr(message, "encoding"):
        return message.encoding in _DEPTH
    return any(word in message.format.lower() for word in ("depth", "16uc1", "32fc1", "mono16"))


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
    return _compressed_depth(bytes(message.data), message.format.lower(), files, f"{name}.png")


def _compressed_depth(data: bytes, kind: str, files: FrameFiles, name: str) -> Path:
    """Write what compressed_depth_image_transport or a plain PNG holds; raises `InvalidScanError` for anything else.

    The transport's header is a format and two floats. Floats in metres stand as 16 bits of their inverse: the depth is
    a / (value - b) with those two.
    """
    is_plain = data.startswith(_PNG)
    header, packed = (b"", data) if is_plain else (data[: _HEADER.size], data[_HEADER.size :])
    raw = _rvl(packed) if "rvl" in kind else _png(packed)
    if raw is None or (not is_plain and len(header) < _HEADER.size):
        raise InvalidScanError("The bag's compressed depth is neither a PNG of 16 bits nor RVL.")
    if "32fc1" not in kind:
        return files.write_depth(name, raw)
    if is_plain:
        raise InvalidScanError(
            "The bag's depth of floats is compressed without the range that they stand for."
        )
    _, a, b = _HEADER.unpack(header)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = np.where(raw > 0, a / (raw.astype(np.float64) - b), 0.0)
    return files.write_depth_m(name, depth_m.astype(np.float32))


def _png(packed: bytes) -> NDArray[np.uint16] | None:
    # OpenCV raises its own error for no bytes at all.
    image = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED) if packed else None
    return None if image is None or image.dtype != np.uint16 else np.asarray(image, dtype=np.uint16)


def _rvl(packed: bytes) -> NDArray[np.uint16] | None:
    if len(packed) < _RVL_SIZE.size:
        return None
    width, height = _RVL_SIZE.unpack_from(packed)
    if not 0 < width * height <= LIMITS.max_pixels:
        return None
    return decode_rvl(packed[_RVL_SIZE.size :], width, height)


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
