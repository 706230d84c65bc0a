"""Zips that were split into parts."""

from __future__ import annotations

import struct
from typing import BinaryIO

_END = struct.Struct("<4s2H")
_MAGIC = b"PK\x05\x06"
# The record at a zip's end, and the comment behind it.
_TAIL_BYTES = 22 + 65_535
# Stands for a number that is in a longer record.
_ELSEWHERE = 0xFFFF


def is_last_part(file: BinaryIO) -> bool:
    """Whether a zip says at its end that it is not the first disk of itself; the file is left at its start."""
    file.seek(0, 2)
    file.seek(-min(_TAIL_BYTES, file.tell()), 2)
    tail = file.read()
    file.seek(0)
    at = tail.rfind(_MAGIC)
    if at < 0 or len(tail) - at < _END.size:
        return False
    _, disk, first = _END.unpack_from(tail, at)
    return any(number not in (0, _ELSEWHERE) for number in (disk, first))
