"""Retrieval of the keyframes most similar to a query: exact L2 search by FAISS (A eq. 4)."""

from __future__ import annotations

from pathlib import Path

import faiss
import numpy as np
from numpy.typing import NDArray

from app.errors import MapDamagedError


class GlobalIndex:
    """Global descriptors (n, d) of a map's keyframes, searched by squared L2 distance."""

    def __init__(self, index: faiss.Index) -> None:
        self._index = index

    @staticmethod
    def from_descriptors(descriptors: NDArray[np.float32]) -> GlobalIndex:
        """Build the index of unit descriptors (n, d); row i is keyframe i."""
        index = faiss.IndexFlatL2(descriptors.shape[1])
        index.add(np.ascontiguousarray(descriptors, dtype=np.float32))
        return GlobalIndex(index)

    @staticmethod
    def open(path: Path) -> GlobalIndex:
        """Open an index file, memory-mapped; raises `MapDamagedError`."""
        try:
            return GlobalIndex(faiss.read_index(str(path), faiss.IO_FLAG_MMAP_IFC))
        except RuntimeError as error:
            raise MapDamagedError(f"{path.name} is not an index of global descriptors.") from error

    def write(self, path: Path) -> None:
        """Write the index to a file."""
        faiss.write_index(self._index, str(path))

    def __len__(self) -> int:
        return int(self._index.ntotal)

    @property
    def descriptors(self) -> NDArray[np.float32]:
        """The descriptors (n, d)."""
        return np.asarray(self._index.reconstruct_n(0, len(self)), dtype=np.float32)

    def descriptor(self, row: int) -> NDArray[np.float32]:
        """Return the descriptor (d,) of one keyframe."""
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
        parameters = None
        if allowed is not None:
            selector = faiss.IDSelectorBatch(allowed.astype(np.int64))
            parameters = faiss.SearchParameters(sel=selector)  # type: ignore[call-arg]
        distances, rows = self._index.search(descriptor[None].astype(np.float32), k, params=parameters)
        return rows[0], distances[0]
