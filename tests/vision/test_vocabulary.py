"""The bag of words: trained words, vectors that tell pictures apart, and the shipped file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.vision.images import to_gray
from app.vision.local_features import Akaze
from app.vision.vocabulary import Vocabulary, train_vocabulary
from tests.scenes import Room, pose_at


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
    first = np.stack([vocabulary.vector(noisy(rng, group, 80)) for group in groups])
    second = np.stack([vocabulary.vector(noisy(rng, group, 80)) for group in groups])
    assert np.allclose(np.linalg.norm(first, axis=1), 1.0, atol=1e-5)
    assert ((first @ second.T).argmax(axis=1) == np.arange(len(groups))).all()


def test_the_shipped_words_find_the_view_of_a_place() -> None:
    vocabulary, akaze = Vocabulary.open(), Akaze()
    rooms = [Room(seed=seed) for seed in (1, 2, 3, 4)]
    monitors, phones = [], []
    for room in rooms:
        for vectors, pose in (
            (monitors, pose_at(1.2, 1.5, 2.0, 0, -10)),
            (phones, pose_at(1.5, 1.3, 1.4, 6)),
        ):
            features = akaze.extract(to_gray(room.view(pose).rgb))
            vectors.append(vocabulary.vector(np.asarray(features.descriptors, np.uint8)))
    similarity = np.stack(phones) @ np.stack(monitors).T
    assert (similarity.argmax(axis=1) == np.arange(len(rooms))).all()


def test_a_picture_without_features_is_like_nothing() -> None:
    vector = Vocabulary.open().vector(np.zeros((0, 61), np.uint8))
    assert not vector.any()


def test_nothing_to_train_on_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        train_vocabulary([np.zeros((1, 61), np.uint8)], 10)
    with pytest.raises(InvalidInputError):
        Vocabulary(np.zeros((3, 61), np.uint8), np.zeros(2, np.float32))
