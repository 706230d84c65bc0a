"""Single features that only one place has vote for the keyframes that show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.query.attempt import votes
from app.engine.query.attempt.votes import OPTIONS, voted_keyframes
from app.geometry.se3 import Pose
from app.vision.matching import to_unit_vectors
from tests.maps import map_of

KEYFRAMES = 4
FEATURES = 50


def descriptors_of(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 255, (FEATURES, 128)).astype(np.uint8)


def made_map(elsewhere: float = 1.2) -> MapArtifact:
    poses = [Pose(np.eye(3), np.array([5.0 * i, 0.0, 0.0])) for i in range(KEYFRAMES)]
    points = [pose.apply(np.random.default_rng(9).uniform(1, 2, (FEATURES, 3))) for pose in poses]
    own = [descriptors_of(i) for i in range(KEYFRAMES)]
    return map_of(poses, points, own, [np.full(FEATURES, elsewhere)] * KEYFRAMES)


def seen(keyframe: int, count: int, others: int = 100) -> NDArray[np.float32]:
    """Return unit descriptors of a picture that shows some features of a keyframe among many others."""
    noise = np.random.default_rng(77).integers(-6, 7, (count, 128))
    shown = np.clip(descriptors_of(keyframe)[:count].astype(int) + noise, 0, 255).astype(np.uint8)
    rest = np.random.default_rng(78).integers(0, 255, (others, 128)).astype(np.uint8)
    return to_unit_vectors(np.concatenate([rest[: others // 2], shown, rest[others // 2 :]]), False)


def test_few_features_among_many_find_their_keyframe() -> None:
    assert voted_keyframes(made_map(), seen(2, 8), 10) == [2]
    both = np.concatenate([seen(1, 6), seen(3, 20, others=0)])
    assert voted_keyframes(made_map(), both, 10) == [3, 1]
    assert voted_keyframes(made_map(), both, 1) == [3]


def test_features_that_are_elsewhere_too_do_not_vote() -> None:
    assert voted_keyframes(made_map(elsewhere=0.01), seen(2, 30), 10) == []


def test_what_nothing_resembles_must_still_be_near() -> None:
    assert voted_keyframes(made_map(elsewhere=np.inf), seen(2, 8), 10) == [2]
    assert voted_keyframes(made_map(elsewhere=np.inf), seen(2, 0), 10) == []


def test_too_few_votes_are_chance() -> None:
    assert voted_keyframes(made_map(), seen(2, OPTIONS.min_votes), 10) == [2]
    assert voted_keyframes(made_map(), seen(2, OPTIONS.min_votes - 1), 10) == []


def test_keyframes_that_are_not_allowed_get_none() -> None:
    both = np.concatenate([seen(1, 6), seen(3, 20, others=0)])
    assert voted_keyframes(made_map(), both, 10, np.array([0, 1])) == [1]
    assert voted_keyframes(made_map(), both, 10, np.zeros(0, np.int64)) == []


def test_a_picture_without_features_has_no_votes() -> None:
    assert voted_keyframes(made_map(), np.zeros((0, 128), np.float32), 10) == []


def test_in_a_map_of_too_many_features_none_votes(monkeypatch: pytest.MonkeyPatch) -> None:
    most = int(OPTIONS.min_share * KEYFRAMES * FEATURES)
    monkeypatch.setattr(votes, "OPTIONS", replace(OPTIONS, map_features=most))
    assert voted_keyframes(made_map(), seen(2, FEATURES), 10) == [2]
    monkeypatch.setattr(votes, "OPTIONS", replace(OPTIONS, map_features=most - 1))
    assert voted_keyframes(made_map(), seen(2, FEATURES), 10) == []


@pytest.mark.parametrize("option", ["chunk", "map_features", "query_features"])
def test_large_maps_and_pictures_are_sampled(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"chunk": 7, "map_features": KEYFRAMES * FEATURES // 2, "query_features": 60}[option]
    monkeypatch.setattr(votes, "OPTIONS", replace(OPTIONS, **{option: few}))
    assert voted_keyframes(made_map(), seen(2, 24), 10) == [2]
