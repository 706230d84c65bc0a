"""The global descriptor and the index that searches it (A eq. 4), and the keyframe rule (A eq. 1-3)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidInputError, MapDamagedError
from app.geometry.se3 import Pose, rotation_from_vector
from app.vision import index as index_module
from app.vision.global_descriptor import GlobalDescriptor
from app.vision.index import GlobalIndex, IndexOptions
from app.vision.keyframes import (
    PoseThresholds,
    PowerLaw,
    matches_by_attitude_difference,
    matches_by_position_difference,
    select_by_pose,
    thresholds_for_matches,
)
from tests.scenes import Room, View, pose_at


@pytest.fixture(scope="module")
def descriptor() -> GlobalDescriptor:
    """The shipped model."""
    return GlobalDescriptor()


def test_the_descriptor_is_of_unit_length_and_repeatable(
    descriptor: GlobalDescriptor, views: list[View]
) -> None:
    a, b = descriptor.describe(views[0].rgb), descriptor.describe(views[0].rgb.copy())
    assert a.shape == (descriptor.size,) == (4096,)
    assert np.linalg.norm(a) == pytest.approx(1, abs=1e-5)
    assert np.array_equal(a, b)
    assert len(descriptor.sha256) == 64


@pytest.mark.parametrize("size", [(240, 320), (480, 640), (1200, 900), (64, 64), (64, 1280)], ids=str)
def test_any_picture_has_a_descriptor(descriptor: GlobalDescriptor, size: tuple[int, int]) -> None:
    vector = descriptor.describe(np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8))
    assert vector.shape == (descriptor.size,)
    assert np.linalg.norm(vector) == pytest.approx(1, abs=1e-5)
    assert np.isfinite(descriptor.describe(np.zeros((*size, 3), np.uint8))).all()


def test_near_views_are_nearer_than_far_ones(descriptor: GlobalDescriptor, room: Room) -> None:
    here, near, behind = (
        descriptor.describe(room.view(pose_at(1.6 + shift, 1.4, 1.4, yaw)).rgb)
        for shift, yaw in ((0, 0), (0.05, 3), (0, 180))
    )
    assert np.sum((here - near) ** 2) < np.sum((here - behind) ** 2)


@pytest.mark.parametrize("content", [None, b"", b"not a model"])
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "model.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InvalidInputError, match=r"model\.onnx"):
        GlobalDescriptor(path)


def unit_vectors(rng: np.random.Generator, n: int, d: int = 24) -> np.ndarray:
    vectors = rng.normal(size=(n, d)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("stored", [False, True], ids=["in memory", "memory-mapped"])
def test_the_index_finds_what_brute_force_finds(tmp_path: Path, stored: bool) -> None:
    rng = np.random.default_rng(1)
    vectors = unit_vectors(rng, 200)
    index = GlobalIndex.from_descriptors(vectors)
    if stored:
        index.write(tmp_path / "index")
        index = GlobalIndex.open(tmp_path / "index")
    assert len(index) == 200
    assert np.array_equal(index.descriptors, vectors)
    for query in unit_vectors(rng, 20):
        squared = np.sum((vectors - query) ** 2, axis=1)
        for allowed in (None, rng.choice(200, 30, replace=False).astype(np.int64), np.array([7], np.int64)):
            candidates = np.arange(200) if allowed is None else allowed
            expected = candidates[np.argsort(squared[candidates])][:10]
            rows, distances = index.search(query, 10, allowed)
            assert rows.tolist() == expected.tolist()
            assert np.allclose(distances, squared[expected], atol=1e-5)


def test_the_index_gives_no_more_than_there_is() -> None:
    index = GlobalIndex.from_descriptors(unit_vectors(np.random.default_rng(2), 3))
    query = unit_vectors(np.random.default_rng(3), 1)[0]
    assert len(index.search(query, 10)[0]) == 3
    assert len(index.search(query, 10, np.zeros(0, np.int64))[0]) == 0


@pytest.mark.parametrize("content", [b"", b"IxF2", b"nonsense" * 100])
def test_a_file_that_is_no_index_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "index").write_bytes(content)
    with pytest.raises(MapDamagedError):
        GlobalIndex.open(tmp_path / "index")


def test_the_papers_numbers() -> None:
    thresholds = thresholds_for_matches(50)
    assert thresholds.position_m == pytest.approx(0.1757, abs=5e-5)
    assert thresholds.attitude_rad == pytest.approx(0.1304, abs=5e-5)
    assert float(matches_by_position_difference(thresholds.position_m)) == pytest.approx(50)
    assert float(matches_by_attitude_difference(thresholds.attitude_rad)) == pytest.approx(50)
    assert np.allclose(matches_by_position_difference([1.0, 4.0]), [19.43, 19.43 * 4**-0.5435])
    assert PowerLaw(2.0, -1.0).inverse(4.0) == pytest.approx(0.5)


LIMITS = PoseThresholds(0.2, 0.15)


def along(xs: list[float], yaws: list[float]) -> list[Pose]:
    return [Pose(rotation_from_vector([0, 0, yaw]), [x, 0, 0]) for x, yaw in zip(xs, yaws, strict=True)]


def test_a_frame_joins_when_no_keyframe_is_close_in_both_respects() -> None:
    assert select_by_pose([], LIMITS) == []
    assert select_by_pose(along([0, 0.1, 0.19, 0.21], [0] * 4), LIMITS) == [0, 3]
    assert select_by_pose(along([0] * 4, [0, 0.1, 0.14, 0.16]), LIMITS) == [0, 3]
    # Far in one respect is far enough.
    assert select_by_pose(along([0, 0.3, 0.01], [0, 0, 0.2]), LIMITS) == [0, 1, 2]
    # Compared with all keyframes, not just the last: the way back adds nothing.
    assert select_by_pose(along([0, 0.3, 0.6, 0.3, 0], [0] * 5), LIMITS) == [0, 1, 2]


def test_the_rule_holds_for_any_walk() -> None:
    rng = np.random.default_rng(4)
    walk = [Pose(rotation_from_vector(rng.normal(size=3) * 0.2), rng.uniform(0, 1, 3)) for _ in range(120)]
    chosen = select_by_pose(walk, LIMITS)

    def close(a: Pose, b: Pose) -> bool:
        angle = np.arccos(np.clip((np.trace(a.rotation.T @ b.rotation) - 1) / 2, -1, 1))
        return bool(
            np.linalg.norm(a.translation - b.translation) < LIMITS.position_m and angle < LIMITS.attitude_rad
        )

    for i, pose in enumerate(walk):
        earlier = [j for j in chosen if j < i]
        assert (i in chosen) == (not any(close(pose, walk[j]) for j in earlier))


def test_a_large_index_finds_what_an_exact_one_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    # Groups of keyframes that look alike, as the places of a building do.
    groups = unit_vectors(rng, 60, 1024)
    vectors = np.repeat(groups, 20, axis=0) + 0.02 * rng.normal(size=(1200, 1024))
    vectors = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)
    exact = GlobalIndex.from_descriptors(vectors)
    monkeypatch.setattr(index_module, "OPTIONS", IndexOptions(flat_keyframes=500))
    made = GlobalIndex.from_descriptors(vectors)
    made.write(tmp_path / "index")
    large = GlobalIndex.open(tmp_path / "index")
    assert (exact.is_exact, large.is_exact, len(large)) == (True, False, 1200)
    assert np.allclose(large.descriptors, vectors, atol=1e-3)
    assert np.allclose(large.descriptor(77), vectors[77], atol=1e-3)
    some, many = np.arange(3, 300, 2), np.arange(0, 1200, 2)
    for row in range(0, 1200, 37):
        query = vectors[row] + 0.01 * rng.normal(size=1024).astype(np.float32)
        for allowed in (None, some, many):
            for k in (1, 10, 200):
                rows, distances = large.search(query, k, allowed)
                expected, squared = exact.search(query, k, allowed)
                assert len(rows) == len(expected)
                assert len(set(rows.tolist()) & set(expected.tolist())) >= 0.9 * len(expected)
                assert np.allclose(distances[:3], squared[:3], atol=5e-3)
                assert np.all(np.diff(distances) >= 0)
