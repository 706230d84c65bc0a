"""Retrieval of the keyframes most similar to a query by squared L2 distance (A eq. 4): exact by FAISS in maps of usual
size, in large ones by short codes whose best candidates are ranked by their whole descriptors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import faiss
import numpy as np
from numpy.typing import NDArray

from app.errors import MapDamagedError
from app.limits import limit

MEASURED = "`roomfix large-maps` measures the recall."


@dataclass(frozen=True, slots=True, kw_only=True)
class IndexOptions:
    """From which size on an index is approximate, and how."""

    flat_keyframes: int = limit(
        5000,
        "A map of up to this many keyframes is searched exactly.",
        chosen="By hand: 80 MB of descriptors are read for each query, which takes some hundredths of a second.",
    )
    code_size: int = limit(
        512,
        "Numbers of the short code, of 8 bits each, that a descriptor is projected to.",
        chosen="By hand: a random projection to so many numbers changes squared distances by 6 %.",
    )
    candidates_ratio: float = limit(
        4.0,
        "Candidates by short codes over the keyframes that are asked for.",
        chosen="By hand, after a trial on 20,124 tiled keyframes: 99.9 % of the nearest 200 were among them, 97.9 % at "
        "half of it. " + MEASURED,
    )
    min_candidates: int = limit(
        400,
        "Least number of candidates by short codes.",
        chosen="By hand: to rank them takes a millisecond. " + MEASURED,
    )
    added_rows: int = limit(
        2048, "Descriptors that are added to an index at a time.", chosen="By hand: bounds the memory."
    )


OPTIONS = IndexOptions()
# Of the random projection; any number does.
SEED = 5
# Of a number in half precision.
HALF_BYTES = 2
# What FAISS writes after the whole descriptors of a large index.
TAIL_BYTES = 4


class FileChecker(Protocol):
    """Verifies parts of an index file; both raise `MapDamagedError`."""

    is_damaged: bool

    def check(self, first: int, end: int) -> None:
        """Verify the bytes from `first` to `end`."""

    def check_rows(self, firsts: NDArray[np.int64], row_bytes: int) -> None:
        """Verify the rows of `row_bytes` that begin at the bytes `firsts` (m,)."""


@dataclass(frozen=True, slots=True)
class CheckedDescriptors:
    """Where the whole descriptors of a large index are in its file, and what verifies them before they are used."""

    checker: FileChecker
    first_byte: int
    row_bytes: int

    def check(self, rows: NDArray[np.int64]) -> None:
        """Verify the descriptors of some keyframes; raises `MapDamagedError`."""
        self.checker.check_rows(self.first_byte + rows * self.row_bytes, self.row_bytes)


class GlobalIndex:
    """Global descriptors (n, d) of a map's keyframes, searched by squared L2 distance."""

    def __init__(self, index: faiss.Index, checked: CheckedDescriptors | None = None) -> None:
        self._index = index
        self._checked = checked

    @staticmethod
    def from_descriptors(descriptors: NDArray[np.float32]) -> GlobalIndex:
        """Build the index of unit descriptors (n, d); row i is keyframe i. Its kind is chosen by n."""
        if len(descriptors) > OPTIONS.flat_keyframes:
            return GlobalIndex(_large_index(descriptors))
        index = faiss.IndexFlatL2(descriptors.shape[1])
        index.add(np.ascontiguousarray(descriptors, dtype=np.float32))
        return GlobalIndex(index)

    @property
    def is_exact(self) -> bool:
        """Whether a search compares the whole descriptors of all keyframes."""
        return not isinstance(self._index, faiss.IndexRefine)

    @staticmethod
    def open(path: Path) -> GlobalIndex:
        """Open an index file, memory-mapped; raises `MapDamagedError`."""
        try:
            return GlobalIndex(faiss.read_index(str(path), faiss.IO_FLAG_MMAP_IFC))
        except RuntimeError as error:
            raise MapDamagedError(f"{path.name} is not an index of global descriptors.") from error

    @staticmethod
    def open_large(path: Path, checker: FileChecker, count: int, size: int) -> GlobalIndex:
        """Open the file of an index of short codes for `count` descriptors of `size` numbers; raises `MapDamagedError`.

        Everything but the whole descriptors is verified at once, each of those before its first use.
        """
        row_bytes, file_bytes = HALF_BYTES * size, path.stat().st_size
        first = file_bytes - TAIL_BYTES - count * row_bytes
        if first <= 0:
            raise MapDamagedError(f"{path.name} is not an index of {count} global descriptors.")
        checker.check(0, first)
        checker.check(file_bytes - TAIL_BYTES, file_bytes)
        opened = GlobalIndex.open(path)
        if opened.is_exact or len(opened) != count or opened.size != size:
            raise MapDamagedError(f"{path.name} is not a large index of {count} global descriptors.")
        return GlobalIndex(opened._index, CheckedDescriptors(checker, first, row_bytes))

    @property
    def is_damaged(self) -> bool:
        """Whether a part of the file that was read has another checksum than its contents."""
        return self._checked is not None and self._checked.checker.is_damaged

    @property
    def size(self) -> int:
        """Numbers of a descriptor."""
        return int(self._index.d)

    def write(self, path: Path) -> None:
        """Write the index to a file."""
        faiss.write_index(self._index, str(path))

    def __len__(self) -> int:
        return int(self._index.ntotal)

    @property
    def descriptors(self) -> NDArray[np.float32]:
        """The descriptors (n, d)."""
        self._check(np.arange(len(self)))
        return np.asarray(self._index.reconstruct_n(0, len(self)), dtype=np.float32)

    def descriptor(self, row: int) -> NDArray[np.float32]:
        """Return the descriptor (d,) of one keyframe."""
        self._check(np.array([row]))
        return np.asarray(self._index.reconstruct(row), dtype=np.float32)

    def search(
        self, descriptor: NDArray[np.float32], k: int, allowed: NDArray[np.int64] | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the `k` keyframes nearest to a descriptor (d,), and their squared distances (A eq. 4).

        `allowed` (m,) restricts the search to those keyframes.
        """
        k = min(k, len(self) if allowed is None else len(allowed))
        if k == 0:
            return np.zeros(0, np.int64), np.zeros(0, np.float32)
        if not self.is_exact and allowed is not None and len(allowed) <= OPTIONS.flat_keyframes:
            return self._search_rows(descriptor, k, allowed.astype(np.int64))
        selection = None if allowed is None else self._selection(allowed)
        query = descriptor[None].astype(np.float32)
        if isinstance(self._index, faiss.IndexRefine):
            candidates = max(OPTIONS.min_candidates, round(OPTIONS.candidates_ratio * k))
            _, rows = self._index.base_index.search(query, min(candidates, len(self)), params=selection)
            ranked = rows[0][rows[0] >= 0]
            self._check(ranked)
            selection = self._selection(ranked)
            distances, rows = self._index.refine_index.search(query, k, params=selection)
        else:
            distances, rows = self._index.search(query, k, params=selection)
        found = rows[0] >= 0
        return rows[0][found], distances[0][found]

    def _selection(self, rows: NDArray[np.int64]) -> faiss.SearchParameters:
        """Return the parameters of a search among some keyframes."""
        is_allowed = np.zeros(len(self), dtype=bool)
        is_allowed[rows] = True
        bits = np.packbits(is_allowed, bitorder="little")
        selector = faiss.IDSelectorBitmap(bits)  # type: ignore[call-arg, arg-type]
        return faiss.SearchParameters(sel=selector)  # type: ignore[call-arg]

    def _search_rows(
        self, descriptor: NDArray[np.float32], k: int, rows: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Search some keyframes exactly."""
        self._check(rows)
        offsets = self._index.reconstruct_batch(rows) - descriptor
        squared = np.einsum("ij,ij->i", offsets, offsets)
        best = np.argsort(squared, kind="stable")[:k]
        return rows[best], squared[best].astype(np.float32)

    def _check(self, rows: NDArray[np.int64]) -> None:
        if self._checked is not None:
            self._checked.check(rows)


def _large_index(descriptors: NDArray[np.float32]) -> faiss.Index:
    """Return an index of short codes, refined by the descriptors in half precision; all of them are looked through."""
    count, size = descriptors.shape
    code_size = min(OPTIONS.code_size, size)
    projection = faiss.RandomRotationMatrix(size, code_size)
    projection.init(SEED)
    codes = faiss.IndexScalarQuantizer(code_size, faiss.ScalarQuantizer.QT_8bit, faiss.METRIC_L2)
    whole = faiss.IndexScalarQuantizer(size, faiss.ScalarQuantizer.QT_fp16, faiss.METRIC_L2)
    index = faiss.IndexRefine(faiss.IndexPreTransform(projection, codes), whole)
    sample = np.linspace(0, count - 1, min(count, OPTIONS.flat_keyframes)).astype(np.int64)
    index.train(np.ascontiguousarray(descriptors[sample], dtype=np.float32))
    for start in range(0, count, OPTIONS.added_rows):
        index.add(np.ascontiguousarray(descriptors[start : start + OPTIONS.added_rows], dtype=np.float32))
    return index
