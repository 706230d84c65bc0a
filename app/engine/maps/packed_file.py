"""A packed file: named arrays and metadata in one file that is memory-mapped, with checksums.

Layout: the magic, the header's length (8 bytes, little endian), a checksum (8 bytes) of header and table, a JSON header
(metadata; name, dtype, shape and offset of each array; size and blocks of the body), the table of the body's checksums
(8 bytes for each block), then the body: the arrays, each aligned to 64 bytes.

Files of the form before had no checksums: the magic, the header's length, the header, the arrays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.checked_rows import (
    OPTIONS,
    BlockChecker,
    CheckedRows,
    checksum,
    checksums_of_blocks,
)
from app.errors import MapDamagedError

MAGIC = b"RFMAP003"
MAGIC_WITHOUT_CHECKSUMS = b"RFMAP002"
ALIGNMENT = 64
# Bytes of a file that are written, or read again, at a time.
PIECE_BYTES = 1 << 24
PREFIX_BYTES = 24
PREFIX_BYTES_WITHOUT_CHECKSUMS = 16


@dataclass(frozen=True, slots=True)
class PackedFile:
    """What a file holds. `checker` is None for a file without checksums."""

    metadata: Any
    arrays: dict[str, Any]
    checker: BlockChecker | None


class Rows(Protocol):
    """An array (n, ...) whose rows are read in slices: one in memory, memory-mapped, or made as it is read."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its numbers."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Its shape."""

    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


def write_packed(path: Path, metadata: Mapping[str, Any], arrays: Mapping[str, Rows]) -> None:
    """Write metadata and arrays to a file, a few rows at a time."""
    table, body_bytes = _table(arrays)
    header = {
        "metadata": metadata,
        "arrays": table,
        "body_bytes": body_bytes,
        "block_bytes": OPTIONS.block_bytes,
    }
    text = json.dumps(header, separators=(",", ":")).encode()
    blocks = -(-body_bytes // OPTIONS.block_bytes)
    start = _aligned(PREFIX_BYTES + len(text) + 8 * blocks)
    with path.open("w+b") as file:
        file.truncate(start + body_bytes)
        for name, array in arrays.items():
            file.seek(start + table[name]["offset"])
            _write_rows(file, array)
        file.seek(start)
        described = text + _checksums_of(file).astype("<u8").tobytes()
        file.seek(0)
        file.write(MAGIC + len(text).to_bytes(8, "little") + checksum(described).to_bytes(8, "little"))
        file.write(described)


def read_packed(path: Path, large: Set[str]) -> PackedFile:
    """Memory-map a file that `write_packed` made, of this form or the one before; raises `MapDamagedError`.

    A file of up to `OPTIONS.eager_bytes` is verified whole, and its arrays are NumPy's. In a larger one the arrays
    named in `large` are `CheckedRows`.
    """
    try:
        data = np.memmap(path, dtype=np.uint8, mode="r")
        if bytes(data[:8]) == MAGIC_WITHOUT_CHECKSUMS:
            return _read_without_checksums(path, data)
        return _read(path, data, large)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapDamagedError(f"{path.name} is not a map artefact ({error}).") from error


def _read(path: Path, data: NDArray[np.uint8], large: Set[str]) -> PackedFile:
    length = int.from_bytes(bytes(data[8:16]), "little")
    if bytes(data[:8]) != MAGIC or PREFIX_BYTES + length > len(data):
        raise MapDamagedError(f"{path.name} is not a map artefact.")
    # Where the table ends is known once the header was read, which its checksum has yet to confirm.
    header = json.loads(bytes(data[PREFIX_BYTES : PREFIX_BYTES + length]))
    body_bytes, block_bytes = int(header["body_bytes"]), int(header["block_bytes"])
    blocks = -(-body_bytes // block_bytes) if min(body_bytes, block_bytes) >= 0 and block_bytes else 0
    end = PREFIX_BYTES + length + 8 * blocks
    if end > len(data) or checksum(data[PREFIX_BYTES:end]) != int.from_bytes(bytes(data[16:24]), "little"):
        raise MapDamagedError(f"The map file {path.name} is damaged: its header has another checksum.")
    start = _aligned(end)
    if len(data) != start + body_bytes:
        raise MapDamagedError(f"The map file {path.name} is cut short.")
    checksums = np.frombuffer(data[PREFIX_BYTES + length : end].tobytes(), "<u8").astype(np.uint64)
    body = data[start:]
    checker = BlockChecker(body, checksums, block_bytes, path.name)
    is_small = body_bytes <= OPTIONS.eager_bytes
    if is_small:
        checker.check_all()
    arrays: dict[str, Any] = {}
    for name, entry in header["arrays"].items():
        view = _view(body, entry)
        if not is_small and name in large:
            arrays[name] = CheckedRows(view, entry["offset"], checker)
        else:
            checker.check(entry["offset"], entry["offset"] + view.nbytes)
            arrays[name] = view
    return PackedFile(header["metadata"], arrays, checker)


def _read_without_checksums(path: Path, data: NDArray[np.uint8]) -> PackedFile:
    length = int.from_bytes(bytes(data[8:16]), "little")
    first = PREFIX_BYTES_WITHOUT_CHECKSUMS
    if first + length > len(data):
        raise MapDamagedError(f"{path.name} is not a map artefact.")
    header = json.loads(bytes(data[first : first + length]))
    body = data[_aligned(first + length) :]
    arrays = {name: _view(body, entry) for name, entry in header["arrays"].items()}
    return PackedFile(header["metadata"], arrays, None)


def _write_rows(file: BinaryIO, array: Rows) -> None:
    """Write an array where a file stands, in pieces that need little memory whatever its size."""
    row_bytes = array.dtype.itemsize * math.prod(array.shape[1:])
    step = max(1, PIECE_BYTES // max(1, row_bytes))
    for start in range(0, array.shape[0], step):
        file.write(np.ascontiguousarray(array[start : start + step]).tobytes())


def _checksums_of(file: BinaryIO) -> NDArray[np.uint64]:
    """Return the checksum (b,) of each block of a file from where it stands to its end."""
    size = OPTIONS.block_bytes * max(1, PIECE_BYTES // OPTIONS.block_bytes)
    checksums = [np.zeros(0, np.uint64)]
    while piece := file.read(size):
        checksums.append(checksums_of_blocks(np.frombuffer(piece, np.uint8), OPTIONS.block_bytes))
    return np.concatenate(checksums)


def _aligned(offset: int) -> int:
    return -(-offset // ALIGNMENT) * ALIGNMENT


def _table(arrays: Mapping[str, Rows]) -> tuple[dict[str, dict[str, Any]], int]:
    """Return where each array lies in the body, and the size of the body."""
    table, offset = {}, 0
    for name, array in arrays.items():
        table[name] = {"dtype": array.dtype.str, "shape": list(array.shape), "offset": offset}
        offset = _aligned(offset + array.dtype.itemsize * math.prod(array.shape))
    return table, offset


def _view(body: NDArray[np.uint8], entry: Mapping[str, Any]) -> NDArray[Any]:
    dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
    first = entry["offset"]
    size = int(np.prod(shape)) * dtype.itemsize
    if min((*shape, first)) < 0 or first + size > len(body):
        raise MapDamagedError("The map artefact is cut short.")
    return np.asarray(body[first : first + size].view(dtype).reshape(shape))
