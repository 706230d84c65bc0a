"""Rows of a memory-mapped file whose checksums are verified before their first use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import xxhash
from numpy.typing import NDArray

from app.errors import MapDamagedError
from app.limits import limit

Value = TypeVar("Value", bound=np.generic)
Row = slice | NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ChecksumOptions:
    """How a file is divided for its checksums, and when they are verified."""

    block_bytes: int = limit(
        1 << 18,
        "Bytes of a file that have one checksum.",
        chosen="By hand: the features of one keyframe are about as large, so that a query verifies little that it "
        "doesn't read.",
    )
    index_block_bytes: int = limit(
        1 << 14,
        "The same of the file of a large index.",
        chosen="By hand: a query ranks some hundred keyframes by whole descriptors of 8 kB, which lie apart.",
    )
    eager_bytes: int = limit(
        256_000_000,
        "A file up to this size is verified whole when it is opened; a larger one block by block, at the first use.",
        chosen="By hand: XXH3 reads 256 MB in a few hundredths of a second.",
    )


OPTIONS = ChecksumOptions()


def checksum(data: Any) -> int:
    """Return the 64-bit XXH3 checksum of bytes, or of an array of them."""
    return xxhash.xxh3_64_intdigest(memoryview(data))


def checksums_of_blocks(data: NDArray[np.uint8], block_bytes: int) -> NDArray[np.uint64]:
    """Return the checksum (b,) of each block of bytes (n,)."""
    return np.array(
        [checksum(data[start : start + block_bytes]) for start in range(0, len(data), block_bytes)], np.uint64
    )


class BlockChecker:
    """Verifies the blocks of a file's bytes (n,) against their checksums (b,), each once in a process.

    Safe to share between threads: at worst a block is verified twice.
    """

    def __init__(
        self, data: NDArray[np.uint8], checksums: NDArray[np.uint64], block_bytes: int, name: str
    ) -> None:
        self._data, self._checksums, self._block_bytes, self._name = data, checksums, block_bytes, name
        self._is_verified = np.zeros(len(checksums), dtype=bool)
        self.is_damaged = False

    def check(self, first: int, end: int) -> None:
        """Verify the blocks with the bytes from `first` to `end`; raises `MapDamagedError`."""
        if end > first:
            self._verify(np.arange(first // self._block_bytes, (end - 1) // self._block_bytes + 1))

    def check_rows(self, firsts: NDArray[np.int64], row_bytes: int) -> None:
        """Verify the blocks with the rows of `row_bytes` that begin at the bytes `firsts` (n,)."""
        if len(firsts) and row_bytes:
            starts, ends = firsts // self._block_bytes, (firsts + row_bytes - 1) // self._block_bytes
            self._verify(np.unique(np.concatenate([starts, ends])))

    def check_all(self) -> None:
        """Verify the whole file."""
        self._verify(np.arange(len(self._checksums)))

    def fail(self) -> None:
        """Raise `MapDamagedError`, and remember the damage."""
        self.is_damaged = True
        raise MapDamagedError(
            f"The map file {self._name} is damaged: its checksum is not that of its contents."
        )

    def _verify(self, blocks: NDArray[np.int64]) -> None:
        if self.is_damaged:
            self.fail()
        for block in blocks[~self._is_verified[blocks]].tolist():
            start = block * self._block_bytes
            if checksum(self._data[start : start + self._block_bytes]) != int(self._checksums[block]):
                self.fail()
            self._is_verified[block] = True


class CheckedRows(Generic[Value]):
    """An array (n, ...) of a file that gives its rows as NumPy arrays, after their blocks were verified.

    `first_byte` is where it begins in the bytes of its checker. Not an `ndarray`, so that no operation reads what was
    not verified.
    """

    def __init__(self, values: NDArray[Value], first_byte: int, checker: BlockChecker) -> None:
        self._values, self._first_byte, self._checker = values, first_byte, checker
        self._row_bytes = values.itemsize * int(np.prod(values.shape[1:]))

    def __len__(self) -> int:
        return len(self._values)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the array."""
        return self._values.shape

    @property
    def dtype(self) -> np.dtype[Value]:
        """The type of its numbers."""
        return self._values.dtype

    def __getitem__(self, rows: Row) -> NDArray[Value]:
        if isinstance(rows, slice):
            start, stop, _ = rows.indices(len(self))
            self._checker.check(
                self._first_byte + start * self._row_bytes, self._first_byte + stop * self._row_bytes
            )
        else:
            numbers = np.flatnonzero(rows) if rows.dtype == bool else rows.reshape(-1).astype(np.int64)
            numbers = np.where(numbers < 0, numbers + len(self), numbers)
            self._checker.check_rows(self._first_byte + numbers * self._row_bytes, self._row_bytes)
        return np.asarray(self._values[rows])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self[:], dtype=dtype, copy=copy)

    def searchsorted(self, values: NDArray[Any], side: Any = "left") -> NDArray[np.intp]:
        """Return where values (m,) would be inserted into this sorted array (n,), as `numpy.searchsorted`.

        The numbers on both sides of each result are verified; in a sorted array they prove it.
        """
        found = np.searchsorted(self._values, values, side=side)
        lower, upper = found > 0, found < len(self)
        before, after = self[found[lower] - 1], self[found[upper]]
        if side == "left":
            is_right = np.all(before < values[lower]) and np.all(values[upper] <= after)
        else:
            is_right = np.all(before <= values[lower]) and np.all(values[upper] < after)
        if not is_right:
            self._checker.fail()
        return np.asarray(found)
