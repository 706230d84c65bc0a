"""Visual words for binary descriptors, and their inverse document frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import faiss
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.limits import limit

DEFAULT_VOCABULARY = Path(__file__).parent.parent / "models" / "akaze_vocabulary.npz"

Binary = NDArray[np.uint8]
Words = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class VocabularyOptions:
    """How a vocabulary is trained."""

    training_steps: int = limit(
        12,
        "Iterations of the clustering.",
        chosen="By hand: meant to be enough to converge.",
    )


OPTIONS = VocabularyOptions()


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """Visual words (w, bytes), which are binary descriptors, and their inverse document frequencies (w,).

    Sources: Sivic and Zisserman, "Video Google", 2003; binary words as in DBoW.
    """

    words: Binary
    idf: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.words.ndim != 2 or self.words.dtype != np.uint8 or self.idf.shape != (len(self.words),):
            raise InvalidInputError("A vocabulary needs words (n, bytes) and one weight for each.")

    @staticmethod
    def open(path: Path = DEFAULT_VOCABULARY) -> Vocabulary:
        """Open a vocabulary file."""
        with np.load(path) as arrays:
            return Vocabulary(arrays["words"], arrays["idf"].astype(np.float32))

    def write(self, path: Path) -> None:
        """Write the vocabulary to a file."""
        np.savez_compressed(path, words=self.words, idf=self.idf)

    def words_of(self, descriptors: Binary) -> Words:
        """Return the nearest word (n,), by Hamming distance, of each descriptor (n, bytes)."""
        return self.nearest(descriptors, 1)[:, 0]

    def nearest(self, descriptors: Binary, count: int) -> Words:
        """Return the `count` nearest words (n, count) of each descriptor (n, bytes), nearest first."""
        if len(descriptors) == 0:
            return np.zeros((0, count), np.int64)
        return _nearest(self.words, descriptors, min(count, len(self.words)))[0]


def train_vocabulary(pictures: list[Binary], size: int, seed: int = 0) -> Vocabulary:
    """Return a vocabulary of up to `size` words for the descriptors (n, bytes) of many pictures.

    k-majority: each descriptor belongs to its nearest word, and each bit of a word becomes the majority of that bit
    in its descriptors. Source: Grana et al., "A fast approach for integrating ORB descriptors in the bag of words
    model", 2013.
    """
    everything = np.unique(np.concatenate(pictures), axis=0)
    if len(everything) < 2:
        raise InvalidInputError("A vocabulary needs pictures with descriptors.")
    rng = np.random.default_rng(seed)
    words = everything[rng.choice(len(everything), min(size, len(everything)), replace=False)]
    bits = np.unpackbits(everything, axis=1).astype(np.float32)
    for _ in range(OPTIONS.training_steps):
        rows, distances = _nearest(words, everything)
        nearest = rows[:, 0]
        words = _majorities(bits, nearest, words)
        words = _reseeded(words, nearest, everything, distances[:, 0])
    documents = np.zeros(len(words))
    for picture in pictures:
        documents[np.unique(_nearest(words, picture)[0])] += 1
    idf = np.log((1.0 + len(pictures)) / (1.0 + documents))
    return Vocabulary(words, idf.astype(np.float32))


def _nearest(words: Binary, descriptors: Binary, count: int = 1) -> tuple[Words, NDArray[np.int32]]:
    """Return the nearest words (n, count) and their distances in bits (n, count)."""
    index = faiss.IndexBinaryFlat(8 * words.shape[1])
    index.add(np.ascontiguousarray(words))
    distances, rows = index.search(np.ascontiguousarray(descriptors), count)
    return rows.astype(np.int64), distances


def _majorities(bits: NDArray[np.float32], nearest: NDArray[np.int64], words: Binary) -> Binary:
    """Return each word as the majority, bit by bit, of the descriptors that belong to it."""
    counts = np.bincount(nearest, minlength=len(words))
    order = np.argsort(nearest, kind="stable")
    ends = np.cumsum(counts)
    sums = np.zeros((len(words), bits.shape[1]), np.float32)
    for word in np.flatnonzero(counts):
        sums[word] = bits[order[ends[word] - counts[word] : ends[word]]].sum(axis=0)
    packed = np.packbits(sums > 0.5 * counts[:, None], axis=1)
    return np.where(counts[:, None] > 0, packed, words)


def _reseeded(
    words: Binary, nearest: NDArray[np.int64], everything: Binary, distances: NDArray[np.int32]
) -> Binary:
    """Return the words; those without descriptors are replaced by the descriptors furthest from their words."""
    empty = np.flatnonzero(np.bincount(nearest, minlength=len(words)) == 0)
    moved = words.copy()
    moved[empty] = everything[np.argsort(-distances, kind="stable")[: len(empty)]]
    return moved
