"""A large map made of copies of a real one, none of which looks like another.

Each copy lies beside the others, and its descriptors are the real ones with their numbers in another order: distances
within a copy stay what they are, and between copies they are those of unrelated places. The first copy is the real map,
so that real pictures can be located in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArrays, MapArtifact
from app.storage.map_files import write_map
from app.vision.index import GlobalIndex

# Further apart than any venue is wide.
SPACING_M = 300.0


@dataclass(frozen=True, slots=True)
class Tiled:
    """The files of a tiled map, and its global descriptors (k, d), memory-mapped."""

    artifact_path: Path
    index_path: Path
    descriptors: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class CopiedRows:
    """An array (copies * n, ...) of all copies, of which no more than what is read is in memory.

    `copied` gives an array (n, ...) as it is in a copy.
    """

    array: NDArray[Any]
    copies: int
    copied: Callable[[NDArray[Any], int], NDArray[Any]]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its numbers."""
        return self.array.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of all copies together."""
        return (self.copies * len(self.array), *self.array.shape[1:])

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        start, stop, _ = rows.indices(self.shape[0])
        count = len(self.array)
        parts = [self.array[:0]]
        for copy in range(start // count, -(-stop // count)):
            within = slice(max(0, start - copy * count), min(count, stop - copy * count))
            parts.append(self.copied(self.array[within], copy))
        return np.concatenate(parts)


def order_of_copy(copy: int, size: int) -> NDArray[np.int64]:
    """Return the order (size,) of a descriptor's numbers in a copy."""
    return np.arange(size) if copy == 0 else np.random.default_rng([copy, size]).permutation(size)


def signs_of_copy(copy: int, size: int) -> NDArray[np.float32]:
    """Return the signs (size,) of a global descriptor's numbers in a copy."""
    if copy == 0:
        return np.ones(size, np.float32)
    return np.random.default_rng([copy, size, 1]).choice(np.array([-1, 1], np.float32), size)


def tile_map(artifact: MapArtifact, index: GlobalIndex, copies: int, folder: Path) -> Tiled:
    """Write a map that holds a map several times, and its index, to a folder.

    Its points alone are in memory, and its index while that is made.
    """
    tiled = _write_descriptors(index.descriptors, copies, folder / "descriptors")
    names = tuple(f"{copy}/{name}" for copy in range(copies) for name in artifact.metadata.keyframe_names)
    whole = MapArtifact(
        metadata=replace(artifact.metadata, keyframe_names=names), arrays=_arrays(artifact, copies)
    )
    write_map(whole, GlobalIndex.from_descriptors(tiled), folder / "map", folder / "index")
    return Tiled(folder / "map", folder / "index", tiled)


def _write_descriptors(descriptors: NDArray[np.float32], copies: int, path: Path) -> NDArray[np.float32]:
    size = descriptors.shape[1]
    with path.open("wb") as file:
        for copy in range(copies):
            (descriptors[:, order_of_copy(copy, size)] * signs_of_copy(copy, size)).tofile(file)
    return np.memmap(path, np.float32, "r").reshape(-1, size)


def _arrays(artifact: MapArtifact, copies: int) -> MapArrays:
    made: dict[str, Any] = {}
    for name in MapArrays.__slots__:
        array = np.asarray(getattr(artifact.arrays, name))
        if name == "offsets":
            counts = np.tile(np.diff(array), copies)
            made[name] = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
            continue
        copied = partial(_copied, name, keyframes=artifact.keyframe_count)
        rows = CopiedRows(array, copies, copied)
        # What the features by place are computed from.
        is_read = len(array) == artifact.keyframe_count or name == "points_in_world"
        made[name] = rows[:] if is_read else rows
    return MapArrays(**made)


def _copied(name: str, array: NDArray[Any], copy: int, *, keyframes: int) -> NDArray[Any]:
    """Return an array of the map as it is in one of the copies."""
    if name in ("positions", "points_in_world"):
        place = np.array([copy % 32, copy // 32, 0], array.dtype) * SPACING_M
        return np.asarray(array + place)
    if name == "keyframe_elsewhere":
        return np.where(array < 0, array, array + copy * keyframes)
    if name == "descriptors":
        return np.take(array, order_of_copy(copy, array.shape[1]), axis=1)
    return array
