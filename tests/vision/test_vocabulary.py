"""Visual words: trained ones tell pictures apart, and the shipped file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.vision.vocabulary import Vocabulary, train_vocabulary


def noisy(rng: np.random.Generator, centres: NDArray[np.uint8], count: int) -> NDArray[np.uint8]:
    """Return descriptors near some centres, a few bits flipped."""
    chosen = np.unpackbits(centres[rng.integers(0, len(centres), count)], axis=1)
    flips = rng.random(chosen.shape) < 0.05
    return np.packbits(chosen ^ flips, axis=1)


def test_pictures_of_the_same_things_are_alike(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    centres = rng.integers(0, 256, (40, 61), dtype=np.uint8)
    groups = [centres[i : i + 8] for i in range(0, 40, 8)]
    trained = train_vocabulary([noisy(rng, group, 100) for group in groups for _ in range(2)], 60)
    trained.write(tmp_path / "words.npz")
    vocabulary = Vocabulary.open(tmp_path / "words.npz")
    counts = np.zeros((2, len(groups), len(vocabulary.words)))
    for row in range(len(groups)):
        for side in (0, 1):
            np.add.at(counts[side, row], vocabulary.words_of(noisy(rng, groups[row], 80)), 1)
    assert ((counts[0] @ counts[1].T).argmax(axis=1) == np.arange(len(groups))).all()


def test_the_nearest_word_comes_first() -> None:
    vocabulary = Vocabulary.open()
    words = vocabulary.nearest(vocabulary.words[:5], 3)
    assert words.shape == (5, 3)
    assert words[:, 0].tolist() == vocabulary.words_of(vocabulary.words[:5]).tolist() == list(range(5))
    assert vocabulary.nearest(np.zeros((0, 61), np.uint8), 3).shape == (0, 3)


def test_nothing_to_train_on_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        train_vocabulary([np.zeros((1, 61), np.uint8)], 10)
    with pytest.raises(InvalidInputError):
        Vocabulary(np.zeros((3, 61), np.uint8), np.zeros(2, np.float32))
