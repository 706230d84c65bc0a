"""How far off a map's features have a look-alike elsewhere: the ratio test, extended to the whole map."""

from __future__ import annotations

from dataclasses import dataclass

import faiss
import numpy as np
from numpy.typing import NDArray

from app.vision.features import Descriptors
from app.vision.matching import to_unit_vectors

# Points further apart than this, heights counting three times, are different things.
ELSEWHERE_M, HEIGHT_WEIGHT = 4.0, 3.0
# A thing is described once by every keyframe that sees it: so many neighbours are looked through to get past it.
NEIGHBOURS = 64
# Cells of the inverted file, in square roots of the number of features, and how many are searched.
CELLS, MAX_CELLS, PROBES = 2.0, 2048, 2
TRAINING_PER_CELL, TRAINING_ROUNDS = 40, 6
CHUNK = 20_000


@dataclass(frozen=True, slots=True)
class Repetition:
    """For each feature (n,): the distance of unit descriptors to the most similar feature at another place, and
    the row of that feature (-1: not found, the distance is a lower bound)."""

    distance: NDArray[np.float32]
    row: NDArray[np.int64]


def find_repetition(
    descriptors: Descriptors | NDArray[np.float16],
    binary: bool,
    points_in_world: NDArray[np.float32],
    among: NDArray[np.int64],
) -> Repetition:
    """Return how far features (n, d) at world points (n, 3) are from looking like something elsewhere: like one of
    those in the rows `among` (m,).

    Approximate: an inverted file finds nearly all. Where all of the nearest 64 are at the same place the distance
    is that of the last of them, which the true one can't be below.
    """
    if len(descriptors) < 2 or len(among) == 0:
        return Repetition(np.full(len(descriptors), np.inf, np.float32), np.full(len(descriptors), -1))
    unit = to_unit_vectors(descriptors, binary)
    index = _inverted_file(unit[among])
    scaled = points_in_world * np.array([1.0, 1.0, HEIGHT_WEIGHT], np.float32)
    parts = [
        _search(index, unit[i : i + CHUNK], scaled[i : i + CHUNK], scaled[among])
        for i in range(0, len(unit), CHUNK)
    ]
    found = np.concatenate([p.row for p in parts])
    rows = np.where(found < 0, -1, among[np.maximum(found, 0)])
    return Repetition(np.concatenate([p.distance for p in parts]), rows)


def _inverted_file(unit: NDArray[np.float32]) -> faiss.Index:
    count, size = unit.shape
    cells = int(np.clip(CELLS * np.sqrt(count), 1, min(MAX_CELLS, count)))
    index = faiss.IndexIVFScalarQuantizer(
        faiss.IndexFlatL2(size), size, cells, faiss.ScalarQuantizer.QT_fp16, faiss.METRIC_L2
    )
    index.cp.niter, index.cp.min_points_per_centroid = TRAINING_ROUNDS, 1
    rows = np.random.default_rng(0).permutation(count)[: cells * TRAINING_PER_CELL]
    index.train(unit[np.sort(rows)])
    index.add(unit)
    index.nprobe = PROBES
    return index


def _search(
    index: faiss.Index,
    unit: NDArray[np.float32],
    points: NDArray[np.float32],
    all_points: NDArray[np.float32],
) -> Repetition:
    squared, rows = index.search(unit, NEIGHBOURS)
    found = rows >= 0
    offsets = all_points[np.maximum(rows, 0)] - points[:, None]
    elsewhere = found & (np.einsum("nki,nki->nk", offsets, offsets) > ELSEWHERE_M**2)
    # Neighbours come nearest first.
    first = elsewhere.argmax(axis=1)
    known = elsewhere.any(axis=1)
    every = np.arange(len(unit))
    # The last neighbour bounds what was not looked at, if anything was left out.
    bound = np.where(found.all(axis=1), squared[:, -1], np.inf)
    nearest = np.where(known, squared[every, first], bound)
    row = np.where(known, rows[every, first], -1)
    return Repetition(np.sqrt(np.maximum(nearest, 0.0)).astype(np.float32), row)
