"""Streams packed by LZMA, with a bound on memory: who packs chooses the size of the dictionary that unpacking takes."""

from __future__ import annotations

import lzma
import zipfile
from dataclasses import dataclass
from typing import BinaryIO

from app.errors import InvalidScanError
from app.limits import limit

MIB = 1024 * 1024
# Of a zip's local header: its size, and where it states the lengths of name and extra field.
LOCAL_HEADER_BYTES = 30
NAME_LENGTH_AT = 26
# Of LZMA data in a zip: version and size of the properties, then the properties: one byte, then the dictionary's size.
LZMA_HEADER_BYTES = 9
DICTIONARY_AT = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class LzmaOptions:
    """How much memory unpacking may take."""

    max_dictionary_bytes: int = limit(
        100 * MIB,
        "Memory that unpacking an xz stream, or an entry of a zip packed by LZMA, may take.",
        chosen="By hand: the largest preset of xz, -9, has a dictionary of 64 MB.",
    )
    read_chunk_bytes: int = limit(
        65_536, "Packed bytes that are read at a time.", chosen="By hand: few calls, and little memory."
    )


OPTIONS = LzmaOptions()
TOO_LARGE = (
    f"The archive needs more than {OPTIONS.max_dictionary_bytes // MIB} MB of memory to be unpacked, for its "
    "dictionary; pack it with a preset of xz (-9 or lower), or with gzip."
)


class XzStream:
    """The unpacked bytes of an xz file, read from its start; raises `InvalidScanError` past the limit of memory."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._decompressor = _decompressor()

    def read(self, size: int) -> bytes:
        """Return `size` unpacked bytes, fewer only at the end."""
        pieces: list[bytes] = []
        missing = size
        while missing and (piece := self._read_some(missing)):
            pieces.append(piece)
            missing -= len(piece)
        return b"".join(pieces)

    def _read_some(self, size: int) -> bytes:
        data = b""
        while not data:
            packed = b""
            if self._decompressor.eof:
                packed = self._next_stream()
                if not packed:
                    return b""
            elif self._decompressor.needs_input:
                packed = self._file.read(OPTIONS.read_chunk_bytes)
                if not packed:
                    raise EOFError("the xz stream ends before its end")
            data = self._unpacked(packed, size)
        return data

    def _unpacked(self, packed: bytes, size: int) -> bytes:
        try:
            return self._decompressor.decompress(packed, size)
        except lzma.LZMAError as error:
            if "Memory usage limit" in str(error):
                raise InvalidScanError(TOO_LARGE) from None
            raise

    def _next_stream(self) -> bytes:
        """Return the first packed bytes of the next stream of the file; streams may be padded with zeros."""
        packed = self._decompressor.unused_data.lstrip(b"\0")
        while not packed:
            chunk = self._file.read(OPTIONS.read_chunk_bytes)
            if not chunk:
                return b""
            packed = chunk.lstrip(b"\0")
        self._decompressor = _decompressor()
        return packed


def _decompressor() -> lzma.LZMADecompressor:
    return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=OPTIONS.max_dictionary_bytes)


def check_zip_dictionary(file: BinaryIO, info: zipfile.ZipInfo) -> None:
    """Raise `InvalidScanError` for an entry of a zip whose LZMA dictionary is too large."""
    if info.compress_type != zipfile.ZIP_LZMA:
        return
    file.seek(info.header_offset)
    header = file.read(LOCAL_HEADER_BYTES)
    name, extra = (
        int.from_bytes(header[at : at + 2], "little") for at in (NAME_LENGTH_AT, NAME_LENGTH_AT + 2)
    )
    file.seek(info.header_offset + LOCAL_HEADER_BYTES + name + extra)
    properties = file.read(LZMA_HEADER_BYTES)
    if int.from_bytes(properties[DICTIONARY_AT:], "little") > OPTIONS.max_dictionary_bytes:
        raise InvalidScanError(TOO_LARGE)
