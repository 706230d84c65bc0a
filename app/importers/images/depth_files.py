"""Depth images as tools write them: PNG, PGM and TIFF, NumPy arrays and OpenEXR, integers or floats.

A file's kind is found by its first bytes. Size and type come from the header, before anything is decoded.
"""

from __future__ import annotations

import io
import re
import tokenize
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from PIL import Image

from app.errors import InvalidScanError
from app.importers.images.exr import ExrHeader, read_exr, read_exr_header
from app.limits import limit
from app.vision.image_files.formats import DAMAGE, TEXT, name_of_other_format

KINDS_IN_WORDS = "a 16-bit PNG or PGM, a TIFF, an OpenEXR image or a NumPy array"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanImageLimits:
    """How large an image of a scan may be."""

    max_pixels: int = limit(
        50_000_000,
        "An image with more pixels is refused before it is decoded.",
        chosen="By hand: as for queries, see ImageOptions.",
    )

    @property
    def in_words(self) -> str:
        """The limit as the end of a sentence."""
        return f"the limit is {self.max_pixels // 1_000_000} megapixels"


LIMITS = ScanImageLimits()
# PNG and TIFF headers and those of NumPy arrays and OpenEXR images are shorter than this.
_HEAD_BYTES = 65_536
# Pillow's modes of one channel with more than 8 bits.
_DEEP_TIFF_MODES = frozenset({"I;16", "I;16L", "I;16B", "I;16N", "I", "F"})
# NumPy reads an array's header as Python text.
_DAMAGED_ARRAY = (*DAMAGE, tokenize.TokenError, RecursionError, MemoryError)
_PGM = re.compile(rb"P([25])(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)\s")


@dataclass(frozen=True, slots=True)
class DepthHeader:
    """The size in pixels of a depth image, and whether it holds floats, which are metres unless something says else."""

    width: int
    height: int
    is_float: bool


def read_depth_header(path: Path) -> DepthHeader | None:
    """Return what a depth image's header says, None for a file that is empty, damaged or of no known kind.

    Raises `InvalidScanError` that names the file for an image that can't hold depth, such as one of 8 bits, a
    photo, or one of more pixels than the limit.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    header = _header_of(head, path.name, path)
    if header is not None and not 0 < header.width * header.height <= LIMITS.max_pixels:
        raise InvalidScanError(f"{path.name} has {header.width} x {header.height} pixels; {LIMITS.in_words}.")
    return header


def read_depth(data: bytes, name: str) -> NDArray[np.generic]:
    """Return the values (height, width) of a depth image, integers or floats; raises `InvalidScanError`."""
    header = _header_of(data[:_HEAD_BYTES], name, io.BytesIO(data))
    if header is None or not 0 < header.width * header.height <= LIMITS.max_pixels:
        raise InvalidScanError(f"{name} is not {KINDS_IN_WORDS}, so it can't be a depth image.")
    decode = next(decode for magic, decode in _DECODERS if data.startswith(magic))
    try:
        values = decode(data)
    except (*_DAMAGED_ARRAY, cv2.error):
        values = None
    if values is None or values.shape != (header.height, header.width):
        raise InvalidScanError(f"{name} is damaged or cut short, so it can't be a depth image.")
    return values


def _header_of(head: bytes, name: str, file: Path | io.BytesIO) -> DepthHeader | None:
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return _png_header(head, name)
    if head.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        return _tiff_header(file, name)
    if head.startswith((b"P2", b"P5")):
        return _pgm_header(head, name)
    if head.startswith(b"\x93NUMPY"):
        return _npy_header(head, name)
    if head.startswith(b"v/1\x01"):
        exr = read_exr_header(head, name)
        return None if exr is None else DepthHeader(exr.width, exr.height, exr.channel_type != ExrHeader.UINT)
    _refuse_by_name(head, name)
    return None


def _refuse_by_name(head: bytes, name: str) -> None:
    """Raise `InvalidScanError` for what is known and holds no depth; the rest is a file that can't be read."""
    kind = name_of_other_format(head[:64])
    # Text in place of one image is a damaged file, which is left out as others are.
    kind = "" if kind == TEXT else kind
    if head.startswith((b"\xff\xd8\xff", b"RIFF")) or (not kind and head[4:8] == b"ftyp"):
        kind = "a picture in a format for photos"
    if name.lower().endswith(".npz") and head.startswith(b"PK"):
        kind = "a NumPy archive (.npz)"
    if kind:
        raise InvalidScanError(f"{name} is {kind}, which is not read as depth: send {KINDS_IN_WORDS}.")


def _png_header(head: bytes, name: str) -> DepthHeader | None:
    if len(head) < 26 or head[12:16] != b"IHDR":
        return None
    width, height = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    bits, color_type = head[24], head[25]
    if bits != 16 or color_type != 0:
        kind = "one channel" if color_type == 0 else "colour, a palette or transparency"
        raise InvalidScanError(
            f"{name} must be a PNG with one channel of 16 bits to be a depth image; it has {kind} and {bits} bits."
        )
    return DepthHeader(width, height, is_float=False)


def _tiff_header(file: Path | io.BytesIO, name: str) -> DepthHeader | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(file, formats=("TIFF",)) as image:
                width, height, mode = image.width, image.height, image.mode
    except Image.DecompressionBombError:
        raise InvalidScanError(f"{name} has too many pixels: {LIMITS.in_words}.") from None
    except DAMAGE:
        return None
    if mode not in _DEEP_TIFF_MODES:
        raise InvalidScanError(
            f"{name} must be a TIFF with one channel of 16 or 32 bits to be a depth image; it is of kind {mode}."
        )
    return DepthHeader(width, height, is_float=mode == "F")


def _pgm_header(head: bytes, name: str) -> DepthHeader | None:
    match = _PGM.match(head)
    if match is None or max(len(group) for group in match.groups()) > 9:
        return None
    width, height, largest = (int(group) for group in match.groups()[1:])
    if match.group(1) == b"2":
        raise InvalidScanError(
            f"{name} is a PGM written as text (P2); save it as binary (P5) or as {KINDS_IN_WORDS}."
        )
    if not 255 < largest <= 65_535:
        raise InvalidScanError(
            f"{name} must be a PGM of 16 bits to be a depth image; its largest value is {largest}."
        )
    return DepthHeader(width, height, is_float=False)


def _npy_header(head: bytes, name: str) -> DepthHeader | None:
    try:
        shape, dtype = _npy_type(io.BytesIO(head))
    except _DAMAGED_ARRAY:
        return None
    flat = [side for side in shape if side != 1] if len(shape) == 3 else list(shape)
    if len(flat) != 2 or dtype.kind not in "uif" or dtype.itemsize < 2:
        raise InvalidScanError(
            f"{name} holds an array of shape {shape} and type {dtype}; a depth image is (height, width), of floats or "
            "of integers with 16 bits or more."
        )
    return DepthHeader(flat[1], flat[0], dtype.kind == "f")


def _npy_type(file: io.BytesIO) -> tuple[tuple[int, ...], np.dtype[np.generic]]:
    version = npy.read_magic(file)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(file)
    return shape, dtype


def _decode_with_opencv(data: bytes) -> NDArray[np.generic] | None:
    raw = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return (
        None if raw is None or raw.dtype != np.uint16 or raw.ndim != 2 else np.asarray(raw, dtype=np.uint16)
    )


def _decode_tiff(data: bytes) -> NDArray[np.generic]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with Image.open(io.BytesIO(data), formats=("TIFF",)) as image:
            return np.asarray(image)


def _decode_npy(data: bytes) -> NDArray[np.generic]:
    # Without pickles, and no longer than the file: the header's shape is checked against the bytes that are there.
    array = npy.read_array(io.BytesIO(data), allow_pickle=False)
    return np.asarray(
        array.reshape([side for side in array.shape if side != 1] if array.ndim == 3 else array.shape)
    )


_DECODERS: tuple[tuple[bytes | tuple[bytes, ...], Callable[[bytes], NDArray[np.generic] | None]], ...] = (
    ((b"\x89PNG", b"P5"), _decode_with_opencv),
    ((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), _decode_tiff),
    (b"\x93NUMPY", _decode_npy),
    (b"v/1\x01", read_exr),
)
