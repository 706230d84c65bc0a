"""Which of a few pictures shows what a query shows: visual words whose every occurrence keeps its descriptor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.vision.vocabulary import Binary, Vocabulary, Words

Scores = NDArray[np.float64]

# So many of a query's features, evenly spread over them, are looked up, each under so many of its nearest words.
MAX_FEATURES, LOOKED_UP = 500, 5
# Descriptors that share a word are of the same thing only when they differ in fewer than this share of their bits; how
# fast a vote fades with that share.
MAX_SHARE, FADING = 110.0 / 486.0, 50.0 / 486.0


class InvertedFile:
    """A list of occurrences for each word, over some pictures.

    Words alone are too coarse to tell one poster from the next: an occurrence votes only when its whole descriptor is
    near the query's. Sources: Jegou et al., "Hamming embedding and weak geometric consistency for large scale image
    search", 2008, here with the descriptors themselves as signatures; for what is repeated within a picture and over
    pictures, Jegou et al., "On the burstiness of visual elements", 2009.
    """

    def __init__(self, vocabulary: Vocabulary, pictures: Sequence[tuple[Words, Binary]]) -> None:
        """Take each picture's words (n,) and descriptors (n, bytes)."""
        self._vocabulary = vocabulary
        self._pictures = len(pictures)
        self._bits = 8 * vocabulary.words.shape[1]
        words = np.concatenate([np.zeros(0, np.int64), *(words for words, _ in pictures)]).astype(np.int64)
        owners = np.repeat(np.arange(len(pictures)), [len(words) for words, _ in pictures])
        descriptors = np.concatenate([vocabulary.words[:0], *(found for _, found in pictures)])
        order = np.argsort(words, kind="stable")
        self._owners, self._descriptors = owners[order], _in_long_words(descriptors[order])
        self._ends = np.searchsorted(words[order], np.arange(len(vocabulary.words) + 1))

    def scores(self, descriptors: Binary) -> Scores:
        """Return how much a query with these descriptors (n, bytes) looks like each picture, (p,)."""
        if len(descriptors) == 0 or len(self._owners) == 0:
            return np.zeros(self._pictures)
        descriptors = descriptors[:: -(-len(descriptors) // MAX_FEATURES)]
        features, entries, weights = self._met(descriptors)
        differing = self._descriptors[entries] ^ _in_long_words(descriptors)[features]
        shares = np.bitwise_count(differing).sum(axis=1, dtype=np.int64) / self._bits
        near = shares < MAX_SHARE
        votes = np.zeros((len(descriptors), self._pictures))
        # One occurrence a picture is enough: a tiled wall repeats what it has.
        np.maximum.at(
            votes,
            (features[near], self._owners[entries[near]]),
            weights[near] * np.exp(-((shares[near] / FADING) ** 2)),
        )
        # What looks like many pictures says little of which it is.
        totals = np.maximum(votes.sum(axis=1, keepdims=True), 1e-12)
        return np.asarray((votes**2 / totals).sum(axis=0))

    def _met(self, descriptors: Binary) -> tuple[NDArray[np.intp], NDArray[np.intp], Scores]:
        """Return what the query's features meet under their words: rows (m,) of features and of occurrences, and the
        words' weights (m,)."""
        words = self._vocabulary.nearest(descriptors, LOOKED_UP)
        features = np.repeat(np.arange(len(words)), words.shape[1])
        flat = words.reshape(-1)
        starts, counts = self._ends[flat], self._ends[flat + 1] - self._ends[flat]
        before = np.concatenate([[0], np.cumsum(counts)[:-1]])
        entries = np.arange(counts.sum()) + np.repeat(starts - before, counts)
        weights = self._vocabulary.idf[flat].astype(np.float64) ** 2
        return np.repeat(features, counts), entries, np.repeat(weights, counts)


def _in_long_words(descriptors: Binary) -> NDArray[np.uint64]:
    """Return descriptors (n, bytes) as numbers of 64 bits (n, w), which are compared eight bytes at a time."""
    padded = np.pad(descriptors, ((0, 0), (0, -descriptors.shape[1] % 8)))
    return np.ascontiguousarray(padded).view(np.uint64)
