"""OpenEXR depth images: one part, by scan lines, without compression or with RLE, ZIPS or ZIP.

After the format's published file layout (openexr.com, "OpenEXR File Layout"). OpenCV's own reader is switched off in
its wheels, as it was not made for files that nobody vouches for.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError

_TILED = 0x200
_DEEP = 0x800
_MULTIPART = 0x1000
# Number of a compression -> its name, and how many lines are compressed together where that is read here.
_COMPRESSIONS = {
    0: ("no", 1),
    1: ("RLE", 1),
    2: ("ZIPS", 1),
    3: ("ZIP", 16),
    4: ("PIZ", None),
    5: ("PXR24", None),
    6: ("B44", None),
    7: ("B44A", None),
    8: ("DWAA", None),
    9: ("DWAB", None),
}
# Names of the channel that holds the depth, most certain first; renderers put layers in front of them.
_DEPTH_CHANNELS = ("z", "depth", "d", "v", "y", "r")
_MAX_ATTRIBUTES = 200
_MAX_CHANNELS = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class ExrHeader:
    """What is needed to read one channel: size in pixels, its type and place in a line, and the compression."""

    UINT: ClassVar[int] = 0
    HALF: ClassVar[int] = 1
    FLOAT: ClassVar[int] = 2

    width: int
    height: int
    first_line: int
    channel_type: int
    bytes_before_channel: int
    bytes_per_pixel: int
    lines_per_block: int
    compression: int
    end: int

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type of the channel's values."""
        return np.dtype({self.UINT: "<u4", self.HALF: "<f2", self.FLOAT: "<f4"}[self.channel_type])


def read_exr_header(head: bytes, name: str) -> ExrHeader | None:
    """Return the header of an OpenEXR file, None if it is damaged.

    Raises `InvalidScanError` that names the file for kinds that are not read: tiles, several parts, deep images,
    other compressions, and channels none of which is known as depth.
    """
    try:
        attributes, end = _attributes(head)
        flags = int.from_bytes(head[4:8], "little")
        if flags & (_TILED | _DEEP | _MULTIPART):
            raise InvalidScanError(
                f"{name} is an OpenEXR image of tiles, parts or deep pixels; save it by scan lines."
            )
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
        compression = attributes["compression"][0]
        words, lines = _COMPRESSIONS.get(compression, (str(compression), None))
        if lines is None:
            raise InvalidScanError(
                f"{name} is an OpenEXR image with {words} compression; save it with ZIP or none."
            )
        channels = _channels(attributes["channels"])
    except (KeyError, IndexError, ValueError, struct.error):
        return None
    chosen = _depth_channel([channel for channel, _ in channels])
    if chosen is None:
        names = ", ".join(channel for channel, _ in channels)
        raise InvalidScanError(
            f"{name} is an OpenEXR image with the channels {names}; name the one with the depth Z."
        )
    sizes = [2 if kind == ExrHeader.HALF else 4 for _, kind in channels]
    return ExrHeader(
        width=right - left + 1,
        height=bottom - top + 1,
        first_line=top,
        channel_type=channels[chosen][1],
        bytes_before_channel=sum(sizes[:chosen]),
        bytes_per_pixel=sum(sizes),
        lines_per_block=lines,
        compression=compression,
        end=end,
    )


def read_exr(data: bytes) -> NDArray[np.generic]:
    """Return the depth channel (height, width) of an OpenEXR file; raises `ValueError` for a damaged one.

    The caller has checked the size in the header, which bounds what is unpacked.
    """
    header = read_exr_header(data, "the file")
    if header is None:
        raise ValueError("the header is damaged")
    blocks = -(-header.height // header.lines_per_block)
    offsets = struct.unpack_from(f"<{blocks}Q", data, header.end)
    out = np.zeros((header.height, header.width), header.dtype)
    for offset in offsets:
        line, size = struct.unpack_from("<iI", data, offset)
        first = line - header.first_line
        if not 0 <= first < header.height:
            raise ValueError("a block is outside of the image")
        count = min(header.lines_per_block, header.height - first)
        packed = data[offset + 8 : offset + 8 + size]
        raw = _unpacked(packed, header.compression, count * header.width * header.bytes_per_pixel)
        lines = np.frombuffer(raw, np.uint8).reshape(count, header.width * header.bytes_per_pixel)
        start = header.bytes_before_channel * header.width
        values = np.ascontiguousarray(lines[:, start : start + header.dtype.itemsize * header.width])
        out[first : first + count] = values.view(header.dtype)
    return out


def _attributes(head: bytes) -> tuple[dict[str, bytes], int]:
    """Return the attributes' bytes by name, and where the header ends."""
    found: dict[str, bytes] = {}
    at = 8
    for _ in range(_MAX_ATTRIBUTES):
        name, at = _text(head, at)
        if not name:
            return found, at
        _, at = _text(head, at)
        (size,) = struct.unpack_from("<I", head, at)
        found[name] = head[at + 4 : at + 4 + size]
        at += 4 + size
    raise ValueError("too many attributes")


def _text(head: bytes, at: int) -> tuple[str, int]:
    end = head.index(b"\0", at)
    return head[at:end].decode("latin-1"), end + 1


def _channels(data: bytes) -> list[tuple[str, int]]:
    """Return the channels in the order of the file: name and type."""
    found = []
    at = 0
    while data[at] != 0:
        name, at = _text(data, at)
        kind, _, step_x, step_y = struct.unpack_from("<iI2i", data, at)
        if kind not in (ExrHeader.UINT, ExrHeader.HALF, ExrHeader.FLOAT) or (step_x, step_y) != (1, 1):
            raise ValueError("a channel of another kind")
        found.append((name, kind))
        at += 16
        if len(found) > _MAX_CHANNELS:
            raise ValueError("too many channels")
    return found


def _depth_channel(names: list[str]) -> int | None:
    if len(names) == 1:
        return 0
    last = [name.lower().rpartition(".")[2] for name in names]
    return next((last.index(wanted) for wanted in _DEPTH_CHANNELS if last.count(wanted) == 1), None)


def _unpacked(packed: bytes, compression: int, size: int) -> bytes:
    """Return the bytes of a block, exactly `size` of them."""
    # A block that compression would make longer is stored as it is.
    if compression == 0 or len(packed) == size:
        return packed[:size]
    if compression == 1:
        mixed = _run_lengths(packed, size)
    else:
        try:
            mixed = zlib.decompressobj().decompress(packed, size)
        except zlib.error:
            raise ValueError("a block is damaged") from None
    if len(mixed) != size:
        raise ValueError("a block is too short")
    # The encoder stores differences to the byte before, plus 128, and all even bytes before all odd ones.
    steps = np.frombuffer(mixed, np.uint8).copy()
    steps[1:] -= np.uint8(128)
    plain = np.cumsum(steps, dtype=np.uint8)
    out = np.empty(size, np.uint8)
    half = (size + 1) // 2
    out[0::2], out[1::2] = plain[:half], plain[half:]
    return out.tobytes()


def _run_lengths(packed: bytes, size: int) -> bytes:
    out = bytearray()
    at = 0
    while at < len(packed) and len(out) <= size:
        count = packed[at] - 256 if packed[at] > 127 else packed[at]
        if count < 0:
            out += packed[at + 1 : at + 1 - count]
            at += 1 - count
        else:
            out += packed[at + 1 : at + 2] * (count + 1)
            at += 2
    return bytes(out)
