"""Matching by one matrix product, against distances counted one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.matching import match_unit_vectors, to_unit_vectors


def brute_force(distances: NDArray[np.float64], ratio: float) -> list[tuple[int, int]]:
    """Return the mutual nearest neighbours whose distance is below `ratio` times the second one."""
    pairs = []
    for i, row in enumerate(distances):
        j = int(row.argmin())
        second = np.delete(row, j).min()
        if distances[:, j].argmin() == i and (ratio >= 1 or row[j] < ratio * second):
            pairs.append((i, j))
    return pairs


def perturbed(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return descriptors, and noisy copies of some of them among others."""
    a = rng.random((60, 32)).astype(np.float32)
    b = np.concatenate([a[:40] + rng.normal(size=(40, 32)).astype(np.float32) * 0.15, rng.random((30, 32))])
    return a, b[rng.permutation(len(b))].astype(np.float32)


@pytest.mark.parametrize("ratio", [0.6, 0.85, 1.0])
def test_real_descriptors_match_as_by_brute_force(ratio: float) -> None:
    for seed in range(5):
        a, b = (to_unit_vectors(d, binary=False) for d in perturbed(np.random.default_rng(seed)))
        assert np.allclose(np.linalg.norm(a, axis=1), 1, atol=1e-5)
        distances = np.linalg.norm(a[:, None].astype(float) - b[None], axis=2)
        rows, columns, ratios = match_unit_vectors(a, b, ratio)
        assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == brute_force(distances, ratio)
        assert len(rows) > 10
        second = np.array([np.partition(row, 1)[1] for row in distances])
        assert np.allclose(ratios, distances[rows, columns] / second[rows], atol=1e-3)


@pytest.mark.parametrize("ratio", [0.7, 0.85, 1.0])
def test_binary_descriptors_match_as_by_counting_bits(ratio: float) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        a = rng.integers(0, 256, (60, 32), dtype=np.uint8)
        flips = np.packbits(rng.random((40, 256)) < 0.2, axis=1)
        b = np.concatenate([a[:40] ^ flips, rng.integers(0, 256, (30, 32), dtype=np.uint8)])
        bits = np.unpackbits(a[:, None] ^ b[None], axis=2).sum(axis=2).astype(float)
        unit_a, unit_b = to_unit_vectors(a, binary=True), to_unit_vectors(b, binary=True)
        assert np.allclose(2 - 2 * unit_a @ unit_b.T, 4 * bits / 256, atol=1e-5)
        rows, columns, ratios = match_unit_vectors(unit_a, unit_b, ratio, binary=True)
        # A tie for the second place or a ratio of just the limit is decided by rounding: none in these seeds.
        assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == brute_force(bits, ratio)
        second = np.array([np.partition(row, 1)[1] for row in bits])
        assert np.allclose(ratios, bits[rows, columns] / second[rows], atol=1e-3)


def test_each_feature_matches_once() -> None:
    a, b = (to_unit_vectors(d, binary=False) for d in perturbed(np.random.default_rng(9)))
    rows, columns, _ = match_unit_vectors(a, b, 1.0)
    assert len(set(rows.tolist())) == len(rows)
    assert len(set(columns.tolist())) == len(columns)


@pytest.mark.parametrize(("n", "m"), [(0, 5), (5, 0), (0, 0), (5, 1)])
def test_too_few_to_tell_match_nothing(n: int, m: int) -> None:
    rng = np.random.default_rng(0)
    a, b = (to_unit_vectors(rng.random((k, 8)).astype(np.float32), binary=False) for k in (n, m))
    assert [len(part) for part in match_unit_vectors(a, b, 0.85)] == [0, 0, 0]


def test_zero_descriptors_stay_finite() -> None:
    assert np.isfinite(to_unit_vectors(np.zeros((3, 8), np.float32), binary=False)).all()
