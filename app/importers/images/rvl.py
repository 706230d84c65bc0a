"""RVL, a lossless compression of depth images that RTAB-Map and ROS use.

Source of the format: A. D. Wilson, "Fast Lossless Depth Image Compression", 2017. A stream of numbers: how many values
are 0, how many follow that are not, and these as differences to the value before; each number stands in groups of three
bits, the lowest first, with a fourth bit that says that another group follows. Eight groups fill a word of 32 bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_HAS_NEXT = 8
_BITS = 3
# Differences of 16-bit values, with a sign, take no more groups than this.
_MAX_GROUPS = 11


def decode_rvl(data: bytes, width: int, height: int) -> NDArray[np.uint16] | None:
    """Return the values (height, width) of compressed depth, None for data that is damaged."""
    numbers = _numbers_of(data)
    values = np.zeros(width * height, dtype=np.int64)
    at = done = 0
    last = 0
    while done < len(values):
        if numbers is None or at + 2 > len(numbers):
            return None
        zeros, count = int(numbers[at]), int(numbers[at + 1])
        steps = numbers[at + 2 : at + 2 + count]
        done, at = done + zeros, at + 2 + count
        if len(steps) < count or done + count > len(values) or zeros + count == 0:
            return None
        if count:
            values[done : done + count] = last + np.cumsum((steps >> 1) ^ -(steps & 1))
            last = int(values[done + count - 1])
        done += count
    is_valid = bool(((values >= 0) & (values <= np.iinfo(np.uint16).max)).all())
    return values.astype(np.uint16).reshape(height, width) if is_valid else None


def _numbers_of(data: bytes) -> NDArray[np.int64] | None:
    """Return all numbers of a stream; the padding at its end becomes zeros."""
    words = np.frombuffer(data[: 4 * (len(data) // 4)], "<u4")
    shifts = np.arange(28, -4, -4, dtype=np.uint32)
    groups = ((words[:, None] >> shifts) & 15).ravel().astype(np.int64)
    ends = np.flatnonzero(groups < _HAS_NEXT)
    if not len(ends):
        return None
    groups = groups[: ends[-1] + 1]
    starts = np.concatenate([[0], ends[:-1] + 1])
    places = np.arange(len(groups)) - np.repeat(starts, ends - starts + 1)
    if places.max() >= _MAX_GROUPS:
        return None
    return np.asarray(np.add.reduceat((groups & 7) << (_BITS * places), starts), dtype=np.int64)
