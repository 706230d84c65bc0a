"""The most similar feature at another place of the map, for a ratio test over the whole map."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import faiss
import numpy as np
from numpy.typing import NDArray

from app.geometry.triangulation import distances_to_segments
from app.limits import limit
from app.vision.features import Descriptors
from app.vision.matching import to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceOptions:
    """When two points, or two keyframes, are at different places of a map."""

    radius_m: float = limit(
        4.0,
        "Two points or keyframes further apart than this are at different places.",
        chosen="By hand: the depth of a room.",
    )
    height_weight: float = limit(
        3.0,
        "Weight of a difference of height in this distance, relative to a difference along the floor. It is 1 in a map "
        "whose z axis is not known to point up.",
        chosen="By hand: a storey of 3 m is beyond the radius, so that the next floor is another place.",
    )

    def axis_weights(self, z_up: bool) -> NDArray[np.float32]:
        """Return the weights (3,) of x, y and z in this distance; `z_up`: whether z is known to point up."""
        return np.array([1.0, 1.0, self.height_weight if z_up else 1.0], np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class RepetitionOptions:
    """The approximate search for the most similar feature at another place."""

    neighbours: int = limit(
        64,
        "Most similar features that are searched for one at another place.",
        chosen="By hand: every keyframe that sees a thing has a feature of it, so the first ones are at one place.",
    )
    cells_ratio: float = limit(
        2.0,
        "Cells of the inverted file over the square root of the number of features.",
        chosen="By hand: a usual choice for inverted files.",
    )
    max_cells: int = limit(
        2048,
        "Largest number of cells of the inverted file.",
        chosen="By hand: bounds the time of its training.",
    )
    searched_cells: int = limit(
        2,
        "Cells of the inverted file that are searched for each feature.",
        chosen="By hand: the nearest neighbour is seldom in another cell.",
    )
    training_features_per_cell: int = limit(
        40,
        "Features per cell that the inverted file is trained on.",
        chosen="By hand: FAISS recommends at least 39.",
    )
    training_steps: int = limit(
        6,
        "k-means iterations of the inverted file's training.",
        chosen="By hand: bounds the time.",
    )
    chunk_features: int = limit(
        20_000,
        "Features that are searched at once.",
        chosen="By hand: bounds the memory.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RayOptions:
    """Where on its ray a feature without a point may be."""

    nearest_m: float = limit(0.3, "It is no nearer than this.", chosen="By hand: an arm's length.")
    farthest_m: float = limit(
        12.0, "It is no farther than this.", chosen="By hand: the length of a large room."
    )


PLACE = PlaceOptions()
RAY = RayOptions()
OPTIONS = RepetitionOptions()


@dataclass(frozen=True, slots=True)
class Repetition:
    """For each feature (n,): the distance of its unit descriptor to the most similar feature at another place, and the
    row of that feature. The row is -1 when none was found; the distance is then a lower bound."""

    distance: NDArray[np.float32]
    row: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Rays:
    """Features that have no point: descriptors (m, d), keyframes (m,), and the centres (m, 3) and directions (m, 3), of
    unit length, of their rays in the world."""

    descriptors: Descriptors
    keyframes: NDArray[np.int64]
    centres: NDArray[np.float64]
    directions: NDArray[np.float64]


# Calls a function with each of some chunks and gives the results in their order, as `map` does.
RunChunks = Callable[[Callable[[slice], Repetition], list[slice]], Iterable[Repetition]]


def find_repetition(
    descriptors: Descriptors | NDArray[np.float16],
    binary: bool,
    points_in_world: NDArray[np.float32],
    among: NDArray[np.int64],
    z_up: bool = True,
    run: RunChunks = map,
) -> Repetition:
    """Return the most similar feature at another place for features (n, d) at world points (n, 3).

    Only the features in the rows `among` (m,) are searched; `z_up` says whether z is known to point up. The search is
    approximate: an inverted file finds nearly all neighbours. When all of the nearest `OPTIONS.neighbours` are at the
    same place, the distance is that of the last of them, a lower bound of the true one. `run` may search chunks of the
    features in several threads.
    """
    if len(descriptors) < 2 or len(among) == 0:
        return Repetition(np.full(len(descriptors), np.inf, np.float32), np.full(len(descriptors), -1))
    index = _inverted_file(descriptors, binary, among)
    scaled = points_in_world * PLACE.axis_weights(z_up)
    searched = scaled[among]

    def search(chunk: slice) -> Repetition:
        def is_elsewhere(rows: NDArray[np.int64]) -> NDArray[np.bool_]:
            offsets = searched[rows] - scaled[chunk][:, None]
            return np.asarray(np.einsum("nki,nki->nk", offsets, offsets) > PLACE.radius_m**2)

        return _search(index, to_unit_vectors(descriptors[chunk], binary), is_elsewhere)

    found = _joined(run(search, _chunks(len(descriptors))))
    rows = np.where(found.row < 0, -1, among[np.maximum(found.row, 0)])
    return Repetition(found.distance, rows)


def find_repetition_on_rays(
    descriptors: Descriptors | NDArray[np.float16],
    binary: bool,
    points_in_world: NDArray[np.float32],
    keyframes: NDArray[np.int64],
    rays: Rays,
    alike: NDArray[np.bool_],
    z_up: bool = True,
    run: RunChunks = map,
) -> Repetition:
    """Return the most similar of the features without a point that are at another place, wherever on their rays they
    are, in keyframes that look alike; the rows are those of `rays`.

    `keyframes` (n,) are those of the features, and `alike` (k, k) says which look alike. Otherwise as
    `find_repetition`.
    """
    if len(descriptors) == 0 or len(rays.descriptors) == 0:
        return Repetition(np.full(len(descriptors), np.inf, np.float32), np.full(len(descriptors), -1))
    index = _inverted_file(rays.descriptors, binary, np.arange(len(rays.descriptors)))
    weights = PLACE.axis_weights(z_up)
    ends = [weights * (rays.centres + m * rays.directions) for m in (RAY.nearest_m, RAY.farthest_m)]
    first, last = (end.astype(np.float32) for end in ends)
    scaled = points_in_world * weights

    def search(chunk: slice) -> Repetition:
        def is_elsewhere(rows: NDArray[np.int64]) -> NDArray[np.bool_]:
            apart_m = distances_to_segments(scaled[chunk][:, None], first[rows], last[rows])
            return (apart_m > PLACE.radius_m) & alike[keyframes[chunk][:, None], rays.keyframes[rows]]

        return _search(index, to_unit_vectors(descriptors[chunk], binary), is_elsewhere)

    found = _joined(run(search, _chunks(len(descriptors))))
    # Of most features no keyframe looks alike: that all neighbours are elsewhere or unlike bounds nothing.
    return Repetition(np.where(found.row < 0, np.float32(np.inf), found.distance), found.row)


def _joined(parts: Iterable[Repetition]) -> Repetition:
    every = list(parts)
    return Repetition(
        np.concatenate([part.distance for part in every]), np.concatenate([part.row for part in every])
    )


def _chunks(count: int) -> list[slice]:
    """Return slices of `OPTIONS.chunk_features` rows, of `count` in all."""
    size = OPTIONS.chunk_features
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def _inverted_file(
    descriptors: Descriptors | NDArray[np.float16], binary: bool, among: NDArray[np.int64]
) -> faiss.Index:
    """Return the index of the unit descriptors in the rows `among` (m,); unit vectors are made a chunk at a time."""
    rows = np.random.default_rng(0).permutation(len(among))
    cells = int(np.clip(OPTIONS.cells_ratio * np.sqrt(len(among)), 1, min(OPTIONS.max_cells, len(among))))
    trained = among[np.sort(rows[: cells * OPTIONS.training_features_per_cell])]
    unit = to_unit_vectors(descriptors[trained], binary)
    size = unit.shape[1]
    index = faiss.IndexIVFScalarQuantizer(
        faiss.IndexFlatL2(size), size, cells, faiss.ScalarQuantizer.QT_fp16, faiss.METRIC_L2
    )
    index.cp.niter, index.cp.min_points_per_centroid = OPTIONS.training_steps, 1
    index.train(unit)
    for chunk in _chunks(len(among)):
        index.add(to_unit_vectors(descriptors[among[chunk]], binary))
    index.nprobe = OPTIONS.searched_cells
    return index


def _search(
    index: faiss.Index,
    unit: NDArray[np.float32],
    is_elsewhere: Callable[[NDArray[np.int64]], NDArray[np.bool_]],
) -> Repetition:
    """Return the most similar features at another place; `is_elsewhere` says which features of the index, in rows
    (n, k), are."""
    squared, rows = index.search(unit, OPTIONS.neighbours)
    found = rows >= 0
    elsewhere = found & is_elsewhere(np.maximum(rows, 0))
    # Neighbours are sorted, nearest first.
    first = elsewhere.argmax(axis=1)
    known = elsewhere.any(axis=1)
    every = np.arange(len(unit))
    # The features that were not returned are at least as far away as the last neighbour.
    bound = np.where(found.all(axis=1), squared[:, -1], np.inf)
    nearest = np.where(known, squared[every, first], bound)
    row = np.where(known, rows[every, first], -1)
    return Repetition(np.sqrt(np.maximum(nearest, 0.0)).astype(np.float32), row)
