"""A large map made of copies of a real one, none of which looks like another.

Each copy lies beside the others, and its descriptors are the real ones with their numbers in another order: distances
within a copy stay what they are, and between copies they are those of unrelated places. The first copy is the real map,
so that real pictures can be located in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArrays, MapArtifact
from app.engine.maps.surroundings import with_places
from app.storage.map_files import file_checksum
from app.vision.index import GlobalIndex

# Further apart than any venue is wide.
SPACING_M = 300.0


@dataclass(frozen=True, slots=True)
class Tiled:
    """The files of a tiled map, and its global descriptors (k, d), memory-mapped."""

    artifact_path: Path
    index_path: Path
    descriptors: NDArray[np.float32]


def order_of_copy(copy: int, size: int) -> NDArray[np.int64]:
    """Return the order (size,) of a descriptor's numbers in a copy."""
    return np.arange(size) if copy == 0 else np.random.default_rng([copy, size]).permutation(size)


def signs_of_copy(copy: int, size: int) -> NDArray[np.float32]:
    """Return the signs (size,) of a global descriptor's numbers in a copy."""
    if copy == 0:
        return np.ones(size, np.float32)
    return np.random.default_rng([copy, size, 1]).choice(np.array([-1, 1], np.float32), size)


def tile_map(artifact: MapArtifact, index: GlobalIndex, copies: int, folder: Path) -> Tiled:
    """Write the map of so many copies of a map, and its index, to a folder."""
    descriptors = index.descriptors
    count, size = descriptors.shape
    tiled = np.memmap(folder / "descriptors", np.float32, "w+", shape=(copies * count, size))
    for copy in range(copies):
        tiled[copy * count : (copy + 1) * count] = descriptors[:, order_of_copy(copy, size)] * signs_of_copy(
            copy, size
        )
    GlobalIndex.from_descriptors(tiled).write(folder / "index")
    names = tuple(f"{copy}/{name}" for copy in range(copies) for name in artifact.metadata.keyframe_names)
    whole = MapArtifact(
        metadata=replace(artifact.metadata, keyframe_names=names), arrays=_arrays(artifact, copies, folder)
    )
    with_places(whole).write(folder / "map", file_checksum(folder / "index"))
    for path in folder.glob("array-*"):
        path.unlink()
    return Tiled(folder / "map", folder / "index", tiled)


def _arrays(artifact: MapArtifact, copies: int, folder: Path) -> MapArrays:
    arrays = {name: np.asarray(getattr(artifact.arrays, name)) for name in MapArrays.__slots__}
    made: dict[str, Any] = {}
    for name, array in arrays.items():
        if name == "offsets":
            counts = np.tile(np.diff(array), copies)
            made[name] = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
            continue
        shape = (copies * len(array), *array.shape[1:])
        made[name] = np.memmap(folder / f"array-{name}", array.dtype, "w+", shape=shape)
        for copy in range(copies):
            made[name][copy * len(array) : (copy + 1) * len(array)] = _copied(
                name, array, copy, artifact.keyframe_count
            )
    return MapArrays(**made)


def _copied(name: str, array: NDArray[Any], copy: int, keyframes: int) -> NDArray[Any]:
    """Return an array of the map as it is in one of the copies."""
    if name in ("positions", "points_in_world"):
        place = np.array([copy % 32, copy // 32, 0], array.dtype) * SPACING_M
        return np.asarray(array + place)
    if name == "keyframe_elsewhere":
        return np.where(array < 0, array, array + copy * keyframes)
    if name == "descriptors":
        return np.take(array, order_of_copy(copy, array.shape[1]), axis=1)
    return array
