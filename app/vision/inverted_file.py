"""Which of several pictures shows the same as a query, by an inverted file of visual words with descriptors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.limits import limit
from app.vision.vocabulary import Binary, Vocabulary, Words

Scores = NDArray[np.float64]

# The bits of an A-KAZE descriptor.
AKAZE_BITS = 486.0


@dataclass(frozen=True, slots=True, kw_only=True)
class InvertedFileOptions:
    """Which features of a query vote for which pictures."""

    max_features: int = limit(
        500,
        "Features of a query that vote, evenly spread over all of them.",
        chosen="By hand: bounds the time.",
    )
    words_per_feature: int = limit(
        5,
        "Nearest words under which a feature of a query is looked up.",
        chosen="By hand: noise often moves a descriptor to a neighbouring word.",
    )
    max_differing_bits: float = limit(
        110.0,
        "A feature of a picture gets a vote when its descriptor differs in fewer bits, of A-KAZE's 486.",
        chosen="By hand; `roomfix evaluate-anchors` counts how often the right picture is first (docs/anchors.md).",
    )
    vote_scale_bits: float = limit(
        50.0,
        "Scale of the Gaussian by which a vote decreases with the differing bits, of A-KAZE's 486.",
        chosen="By hand; `roomfix evaluate-anchors` counts how often the right picture is first (docs/anchors.md).",
    )


OPTIONS = InvertedFileOptions()
MAX_DIFFERING_SHARE = OPTIONS.max_differing_bits / AKAZE_BITS
VOTE_SCALE_SHARE = OPTIONS.vote_scale_bits / AKAZE_BITS


class InvertedFile:
    """A list of features for each word, over several pictures.

    A word is too coarse to distinguish one poster from another, so a feature gets a vote only when its whole
    descriptor is near the query's. Sources: Jegou et al., "Hamming embedding and weak geometric consistency for large
    scale image search", 2008, with the descriptors themselves as signatures; for features that are repeated within a
    picture and over pictures, Jegou et al., "On the burstiness of visual elements", 2009.
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
        """Return the similarity (p,) of each picture to a query with descriptors (n, bytes)."""
        if len(descriptors) == 0 or len(self._owners) == 0:
            return np.zeros(self._pictures)
        descriptors = descriptors[:: -(-len(descriptors) // OPTIONS.max_features)]
        features, entries, weights = self._candidates(descriptors)
        differing = self._descriptors[entries] ^ _in_long_words(descriptors)[features]
        shares = np.bitwise_count(differing).sum(axis=1, dtype=np.int64) / self._bits
        near = shares < MAX_DIFFERING_SHARE
        votes = np.zeros((len(descriptors), self._pictures))
        # A feature votes once for a picture, however often the picture repeats it, as a tiled wall does.
        np.maximum.at(
            votes,
            (features[near], self._owners[entries[near]]),
            weights[near] * np.exp(-((shares[near] / VOTE_SCALE_SHARE) ** 2)),
        )
        # A feature that is found in many pictures distinguishes little between them.
        totals = np.maximum(votes.sum(axis=1, keepdims=True), 1e-12)
        return np.asarray((votes**2 / totals).sum(axis=0))

    def _candidates(self, descriptors: Binary) -> tuple[NDArray[np.intp], NDArray[np.intp], Scores]:
        """Return the pairs of features that share a word: the rows (m,) of the query's features and of the pictures'
        features, and the words' weights (m,)."""
        words = self._vocabulary.nearest(descriptors, OPTIONS.words_per_feature)
        features = np.repeat(np.arange(len(words)), words.shape[1])
        flat = words.reshape(-1)
        starts, counts = self._ends[flat], self._ends[flat + 1] - self._ends[flat]
        before = np.concatenate([[0], np.cumsum(counts)[:-1]])
        entries = np.arange(counts.sum()) + np.repeat(starts - before, counts)
        weights = self._vocabulary.idf[flat].astype(np.float64) ** 2
        return np.repeat(features, counts), entries, np.repeat(weights, counts)


def _in_long_words(descriptors: Binary) -> NDArray[np.uint64]:
    """Return descriptors (n, bytes) as 64-bit integers (n, w), which are compared eight bytes at a time."""
    padded = np.pad(descriptors, ((0, 0), (0, -descriptors.shape[1] % 8)))
    return np.ascontiguousarray(padded).view(np.uint64)
