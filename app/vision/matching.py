"""Matching of descriptors: one matrix product per image pair, ratio test and mutual nearest neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision.features import Descriptors

Unit = NDArray[np.float32]


class DescriptorRows(Protocol):
    """The descriptors of many pictures, of which spans of rows are read."""

    def __getitem__(self, rows: slice, /) -> Descriptors | NDArray[np.float16]: ...


def to_unit_vectors(descriptors: Descriptors | NDArray[np.float16], binary: bool) -> Unit:
    """Return descriptors (n, d) as float32 rows of unit length: a larger scalar product is a smaller distance.

    Bits become +1 and -1: for b bits the scalar product s is 1 - 2 Hamming / b, so 2 - 2 s is 4 Hamming / b.
    """
    if binary:
        signs = np.unpackbits(np.asarray(descriptors, dtype=np.uint8), axis=1).astype(np.float32)
        signs *= 2.0
        signs -= 1.0
        signs /= np.float32(np.sqrt(signs.shape[1]))
        return signs
    values = np.asarray(descriptors, dtype=np.float32)
    norms = np.sqrt(np.einsum("ij,ij->i", values, values))
    return np.asarray(values / np.maximum(norms, np.float32(1e-9))[:, None], dtype=np.float32)


def match_unit_vectors(
    a: Unit, b: Unit, ratio: float, binary: bool = False
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Match rows of `a` (n, d) to rows of `b` (m, d): mutual nearest neighbours that pass the ratio test.

    Returns rows of `a`, rows of `b`, and the ratio of the distance to the second smallest distance (small for a
    distinctive match). Distances are Euclidean, or Hamming for `binary` descriptors (B eq. 3-4). With `ratio` 1 all
    mutual nearest neighbours are kept.
    """
    if len(a) == 0 or len(b) < 2:
        return np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0, np.float32)
    similarity = a @ b.T
    rows = np.arange(len(a))
    nearest = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[nearest] == rows
    rows, nearest = rows[mutual], nearest[mutual]
    best = similarity[rows, nearest]
    candidates = similarity[rows]
    candidates[np.arange(len(rows)), nearest] = -1.0
    ratios = _distance(best, binary) / np.maximum(_distance(candidates.max(axis=1), binary), 1e-6)
    keep = ratios < ratio if ratio < 1.0 else np.ones(len(rows), dtype=bool)
    return rows[keep], nearest[keep], ratios[keep].astype(np.float32)


def match_with_each(
    unit: Unit,
    descriptors: DescriptorRows,
    offsets: NDArray[np.int64],
    pictures: Sequence[int],
    ratio: float,
    binary: bool = False,
) -> list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]]:
    """Match unit descriptors (n, d) with those of each of several pictures, one picture at a time.

    Picture i has the rows `offsets[i]:offsets[i + 1]` of `descriptors` (m, d). Returns, for each picture, rows of
    `unit`, rows of `descriptors`, and the distances of the matched unit vectors (k,).
    """
    found = []
    for picture in pictures:
        start, end = int(offsets[picture]), int(offsets[picture + 1])
        theirs = to_unit_vectors(descriptors[start:end], binary)
        a, b, _ = match_unit_vectors(unit, theirs, ratio, binary)
        found.append((a, start + b, unit_distances(unit[a], theirs[b])))
    return found


def unit_distances(a: Unit, b: Unit) -> NDArray[np.float32]:
    """Return the distances (n,) of unit vectors (n, d) and (n, d)."""
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * np.einsum("ij,ij->i", a, b), 0.0)), dtype=np.float32)


def _distance(similarity: NDArray[np.float32], binary: bool) -> NDArray[np.float32]:
    squared = np.maximum(2.0 - 2.0 * similarity, 0.0)
    return np.asarray(squared if binary else np.sqrt(squared), dtype=np.float32)
