"""The inverted file: the view of a place comes first, however alike the words; and what has no features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.geometry.se3 import Pose
from app.vision.images import to_gray
from app.vision.inverted_file import InvertedFile
from app.vision.local_features import Akaze
from app.vision.vocabulary import Vocabulary
from tests.scenes import Room, pose_at

Binary = NDArray[np.uint8]


def described(room: Room, pose: Pose) -> Binary:
    return np.asarray(Akaze().extract(to_gray(room.view(pose).rgb)).descriptors, np.uint8)


def test_the_view_of_a_place_comes_first() -> None:
    vocabulary, rooms = Vocabulary.open(), [Room(seed=seed) for seed in (1, 2, 3, 4)]
    monitors = [described(room, pose_at(1.2, 1.5, 2.0, 0, -10)) for room in rooms]
    pictures = InvertedFile(vocabulary, [(vocabulary.words_of(one), one) for one in monitors])
    for row, room in enumerate(rooms):
        scores = pictures.scores(described(room, pose_at(1.5, 1.3, 1.4, 6)))
        assert scores.argmax() == row
        assert scores[row] > 2 * np.delete(scores, row).max()


def test_the_same_word_is_not_enough() -> None:
    rng = np.random.default_rng(0)
    vocabulary = Vocabulary(rng.integers(0, 256, (2, 61), np.uint8), np.ones(2, np.float32))
    one, other = rng.integers(0, 256, (2, 30, 61), np.uint8)
    words = np.zeros(30, np.int64)
    pictures = InvertedFile(vocabulary, [(words, one), (words, other)])
    scores = pictures.scores(one)
    assert scores[0] > 25
    assert scores[1] < 0.01


def test_what_is_repeated_in_a_picture_votes_once_and_what_is_everywhere_is_shared() -> None:
    rng = np.random.default_rng(1)
    vocabulary = Vocabulary(rng.integers(0, 256, (1, 61), np.uint8), np.ones(1, np.float32))
    tile = rng.integers(0, 256, (1, 61), np.uint8)
    wall = np.repeat(tile, 50, axis=0)
    zeros = np.zeros(50, np.int64)
    assert np.allclose(InvertedFile(vocabulary, [(zeros, wall)]).scores(tile), 1.0)
    assert np.allclose(InvertedFile(vocabulary, [(zeros, wall), (zeros[:1], tile)]).scores(tile), 0.5)


def test_a_picture_without_features_is_like_nothing() -> None:
    vocabulary, none = Vocabulary.open(), np.zeros((0, 61), np.uint8)
    found = np.full((3, 61), 7, np.uint8)
    pictures = InvertedFile(
        vocabulary, [(vocabulary.words_of(found), found), (vocabulary.words_of(none), none)]
    )
    assert pictures.scores(none).tolist() == [0.0, 0.0]
    assert pictures.scores(found)[0] > 0
    assert pictures.scores(found)[1] == 0
    assert InvertedFile(vocabulary, []).scores(found).shape == (0,)
