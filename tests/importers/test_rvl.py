"""RVL: what an encoder after the paper writes is read, and damaged data is no depth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.importers.images.rvl import decode_rvl


def encode_rvl(depth: NDArray[np.uint16]) -> bytes:
    """Return depth as RVL: counts of zeros and of values, and the values' differences, in groups of three bits."""
    groups: list[int] = []

    def put(number: int) -> None:
        while number > 7:
            groups.append(number & 7 | 8)
            number >>= 3
        groups.append(number)

    values, at, last = depth.ravel().tolist(), 0, 0
    while at < len(values):
        zeros = next((i for i, value in enumerate(values[at:]) if value), len(values) - at)
        at += zeros
        count = next((i for i, value in enumerate(values[at:]) if not value), len(values) - at)
        put(zeros)
        put(count)
        for value in values[at : at + count]:
            put(2 * (value - last) if value >= last else 2 * (last - value) - 1)
            last = value
        at += count
    groups += [0] * (-len(groups) % 8)
    words = [
        sum(group << 28 - 4 * i for i, group in enumerate(groups[k : k + 8]))
        for k in range(0, len(groups), 8)
    ]
    return np.array(words, "<u4").tobytes()


def depth_with_holes() -> NDArray[np.uint16]:
    rng = np.random.default_rng(3)
    depth = rng.integers(300, 9000, (48, 64)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.3] = 0
    depth[:2] = 0
    depth[20] = 65535
    return depth


@pytest.mark.parametrize(
    "depth",
    [
        depth_with_holes(),
        np.zeros((3, 5), np.uint16),
        np.full((4, 4), 1234, np.uint16),
        depth_with_holes()[::-1],
    ],
)
def test_what_was_encoded_comes_back(depth: NDArray[np.uint16]) -> None:
    height, width = depth.shape
    np.testing.assert_array_equal(decode_rvl(encode_rvl(depth), width, height), depth)


def test_data_that_is_too_short_or_random_is_no_depth() -> None:
    data = encode_rvl(depth_with_holes())
    assert decode_rvl(data[: len(data) // 2], 64, 48) is None
    assert decode_rvl(b"", 64, 48) is None
    assert decode_rvl(data, 640, 480) is None
    assert decode_rvl(b"\xff" * 4000, 64, 48) is None
    assert decode_rvl(bytes(4000), 64, 48) is None
    rng = np.random.default_rng(1)
    for _ in range(50):
        found = decode_rvl(rng.bytes(3000), 64, 48)
        assert found is None or found.shape == (48, 64)
