"""How large the coded pictures in an AVIF file are, before any of them is decoded.

The decoder believes the size in the container for its answer, but decodes what the AV1 stream says. After
ISO/IEC 14496-12 (boxes), 23008-12 (items) and the AV1 specification, sections 5.3 to 5.5.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

ANIMATED = "an animated AVIF"
_FULL_BOX_BYTES = 4
_SEQUENCE_HEADER = 1
_CODED_ITEM = b"av01"
_IN_FILE = 0
_IN_ITEM_DATA = 1
# Past any still picture, whose tiles are items of their own.
_MAX_ITEMS = 4096


def largest_coded_pixels(data: bytes) -> int:
    """Return the pixels of the largest AV1 sequence header among an AVIF file's items, 0 if there is none.

    Raises `ValueError` for what is not a file of still pictures or is damaged.
    """
    top = dict(_boxes(data))
    if b"moov" in top:
        raise ValueError(ANIMATED)
    if b"meta" not in top:
        raise ValueError("no picture in it")
    meta = dict(_boxes(top[b"meta"][_FULL_BOX_BYTES:]))
    try:
        coded = _coded_items(meta[b"iinf"])
        items = _item_contents(meta[b"iloc"], data, meta.get(b"idat", b""), coded)
        return max((pixels for item in items for pixels in _sequence_pixels(item)), default=0)
    except (KeyError, IndexError, struct.error):
        raise ValueError("a damaged header") from None


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the kinds and contents of the boxes that stand one after the other."""
    at = 0
    while at + 8 <= len(data):
        size, kind, head = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8], 8
        if size == 1:
            size, head = int.from_bytes(data[at + 8 : at + 16], "big"), 16
        elif size == 0:
            size = len(data) - at
        if size < head or at + size > len(data):
            raise ValueError("a box that is cut short")
        yield kind, data[at + head : at + size]
        at += size


def _coded_items(iinf: bytes) -> set[int]:
    """Return the ids of the items that are AV1 streams."""
    start = _FULL_BOX_BYTES + (2 if iinf[0] == 0 else 4)
    found = set()
    for kind, content in _boxes(iinf[start:]):
        if kind != b"infe" or content[0] < 2:
            continue
        width = 2 if content[0] == 2 else 4
        # The id, two bytes of protection, the type.
        if content[6 + width : 10 + width] == _CODED_ITEM:
            found.add(int.from_bytes(content[4 : 4 + width], "big"))
    return found


class _Reader:
    """Big-endian integers one after the other."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data, self._at = data, at

    def read(self, size: int) -> int:
        if self._at + size > len(self._data):
            raise ValueError("a box that is cut short")
        self._at += size
        return int.from_bytes(self._data[self._at - size : self._at], "big")


def _item_contents(iloc: bytes, data: bytes, item_data: bytes, wanted: set[int]) -> Iterator[bytes]:
    """Yield the contents of the wanted items, put together from their extents."""
    version = iloc[0]
    reader = _Reader(iloc, _FULL_BOX_BYTES)
    sizes = reader.read(2)
    offset_size, length_size, base_size = sizes >> 12, sizes >> 8 & 15, sizes >> 4 & 15
    index_size = sizes & 15 if version > 0 else 0
    count = reader.read(2 if version < 2 else 4)
    if count > _MAX_ITEMS:
        raise ValueError("too many items")
    for _ in range(count):
        item = reader.read(2 if version < 2 else 4)
        method = reader.read(2) & 15 if version > 0 else _IN_FILE
        reader.read(2)
        base = reader.read(base_size)
        content = b""
        for _ in range(reader.read(2)):
            reader.read(index_size)
            offset, length = base + reader.read(offset_size), reader.read(length_size)
            source = {_IN_FILE: data, _IN_ITEM_DATA: item_data}.get(method)
            if source is None or len(content) > len(data):
                raise ValueError("an item that is put together from others")
            if item in wanted:
                content += source[offset : offset + length] if length else source[offset:]
        if item in wanted:
            yield content


def _sequence_pixels(stream: bytes) -> Iterator[int]:
    """Yield the pixels of each sequence header in an AV1 stream; all of its units must state their sizes."""
    at = 0
    while at < len(stream):
        head = stream[at]
        if not head & 2:
            raise ValueError("a unit without a size")
        at += 2 if head & 4 else 1
        size, shift = 0, 0
        while True:
            byte = stream[at]
            size |= (byte & 127) << shift
            at, shift = at + 1, shift + 7
            if not byte & 128 or shift > 56:
                break
        if head >> 3 & 15 == _SEQUENCE_HEADER:
            yield _pixels_of_sequence(stream[at : at + size])
        at += size


class _Bits:
    """Bits of a stream one after the other, the highest first."""

    def __init__(self, data: bytes) -> None:
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)

    def read(self, count: int) -> int:
        self._left -= count
        if self._left < 0:
            raise ValueError("a sequence header that is cut short")
        return self._value >> self._left & ((1 << count) - 1)


def _pixels_of_sequence(content: bytes) -> int:
    """Return the largest frame of a sequence header (AV1 section 5.5.1), width times height."""
    # The part up to the size is far shorter.
    bits = _Bits(content[:256])
    bits.read(4)
    if bits.read(1):
        bits.read(5)
    else:
        _skip_operating_points(bits)
    width_bits, height_bits = bits.read(4) + 1, bits.read(4) + 1
    return (bits.read(width_bits) + 1) * (bits.read(height_bits) + 1)


def _skip_operating_points(bits: _Bits) -> None:
    delay_bits = 0
    if bits.read(1):
        bits.read(64)
        if bits.read(1):
            zeros = 0
            while not bits.read(1):
                zeros += 1
            bits.read(zeros if zeros < 32 else 0)
        if bits.read(1):
            delay_bits = bits.read(5) + 1
            bits.read(42)
    has_display_delay = bits.read(1)
    for _ in range(bits.read(5) + 1):
        bits.read(12)
        if bits.read(5) > 7:
            bits.read(1)
        if delay_bits and bits.read(1):
            bits.read(2 * delay_bits + 1)
        if has_display_delay and bits.read(1):
            bits.read(4)
