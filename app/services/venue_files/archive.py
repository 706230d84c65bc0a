"""The archive of a venue's file: plain tar (POSIX ustar) with regular files only, written and read as a stream."""

from __future__ import annotations

import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import BinaryIO

from app.errors import InvalidInputError
from app.limits import limit

BLOCK_BYTES = tarfile.BLOCKSIZE
# Two blocks of zeros end an archive.
END = bytes(2 * BLOCK_BYTES)
REGULAR = (tarfile.REGTYPE, tarfile.AREGTYPE)
TRUNCATED = "The file ends before its end: it was cut off, or is no file of a venue. Export it again."


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveOptions:
    """How an archive is read and written."""

    chunk_bytes: int = limit(
        1 << 20, "Bytes that are read at a time.", chosen="By hand: few calls, and little memory."
    )


OPTIONS = ArchiveOptions()


def member_bytes(size: int) -> int:
    """Return how long a member of `size` bytes is in the archive."""
    return BLOCK_BYTES + size + _padding(size)


def member(name: str, size: int, chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield a member of an archive; raises `InvalidInputError` when the chunks have another size in all."""
    header = tarfile.TarInfo(name)
    header.size = size
    yield header.tobuf(tarfile.GNU_FORMAT)
    written = 0
    for chunk in chunks:
        written += len(chunk)
        yield chunk
    if written != size:
        raise InvalidInputError(f"{name} has {written} bytes, not {size}.")
    yield bytes(_padding(size))


@dataclass(frozen=True, slots=True)
class Member:
    """A member of an archive that is read; its chunks must be read before the next member."""

    name: str
    size: int
    chunks: Iterator[bytes]


def members(file: BinaryIO) -> Iterator[Member]:
    """Yield the members of an archive in order.

    Headers are read one by one and only as regular files with plain names: no links, sparse files, long names or
    compression, so that nothing unpacks to more than was sent. Raises `InvalidInputError` for everything else.
    """
    while True:
        block = _exactly(file, BLOCK_BYTES)
        if block == bytes(BLOCK_BYTES):
            return
        try:
            header = tarfile.TarInfo.frombuf(block, "ascii", "strict")
        except (tarfile.HeaderError, UnicodeDecodeError, ValueError):
            raise InvalidInputError(
                "This is no file of a venue, or it is damaged: a header can't be read."
            ) from None
        if header.type not in REGULAR or header.size < 0:
            raise InvalidInputError("The file of a venue holds something other than plain files.")
        body = _Body(file, header.size)
        yield Member(header.name, header.size, body.chunks())
        body.finish()


class _Body:
    """The contents of a member, and the padding after it."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self._left = size
        self._padding = _padding(size)

    def chunks(self) -> Iterator[bytes]:
        while self._left:
            chunk = _exactly(self._file, min(self._left, OPTIONS.chunk_bytes))
            self._left -= len(chunk)
            yield chunk

    def finish(self) -> None:
        if self._left:
            raise InvalidInputError("A member of the file was not read whole.")
        _exactly(self._file, self._padding)


def _padding(size: int) -> int:
    return -size % BLOCK_BYTES


def _exactly(file: BinaryIO, size: int) -> bytes:
    pieces, left = [], size
    while left:
        piece = file.read(left)
        if not piece:
            raise InvalidInputError(TRUNCATED)
        pieces.append(piece)
        left -= len(piece)
    return b"".join(pieces)
