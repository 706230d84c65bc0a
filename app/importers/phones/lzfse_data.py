"""Arrays of a phone's recordings that may be compressed by Apple's LZFSE."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError

# First bytes of an LZFSE block: plain, LZFSE (two versions), LZVN, and the end of a stream.
_MAGIC = (b"bvx-", b"bvx1", b"bvx2", b"bvxn", b"bvx$")
# What is not smaller than its contents by this many bytes is no compression of them.
_OVERHEAD_BYTES = 65_536


def unpacked_data(path: Path, dtype: np.dtype[np.generic], shape: tuple[int, int]) -> NDArray[np.generic]:
    """Return the array (height, width) in a file of raw or LZFSE-compressed values.

    Raises `InvalidScanError` for a file of another size, a damaged one, and where the library for LZFSE is missing.
    """
    expected = dtype.itemsize * shape[0] * shape[1]
    data = _unpacked(path, expected)
    if len(data) != expected:
        raise InvalidScanError(
            f"{path.name} holds {len(data)} bytes where {shape[1]} x {shape[0]} values take {expected}: it is damaged, "
            "or of another size than the metadata says."
        )
    return np.frombuffer(data, dtype).reshape(shape)


def values_in(path: Path, dtype: np.dtype[np.generic], most: int) -> int:
    """Return how many values a file of raw or LZFSE-compressed values holds; raises as `unpacked_data`."""
    return len(_unpacked(path, dtype.itemsize * most)) // dtype.itemsize


def _unpacked(path: Path, largest: int) -> bytes:
    if path.stat().st_size > largest + _OVERHEAD_BYTES:
        raise InvalidScanError(f"{path.name} is larger than {largest} bytes of values are.")
    data = path.read_bytes()
    return _decompressed(data, path.name) if data.startswith(_MAGIC) else data


def _decompressed(data: bytes, name: str) -> bytes:
    try:
        import lzfse
    except ImportError:
        raise InvalidScanError(
            f"{name} is compressed by LZFSE, which needs the extra: pip install 'roomfix[scans]'."
        ) from None
    try:
        return bytes(lzfse.decompress(data))
    except (lzfse.error, ValueError, MemoryError):
        raise InvalidScanError(f"{name} is damaged: its LZFSE data can't be read.") from None
