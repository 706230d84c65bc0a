"""The files of a map: what of them is verified when they are opened, and what when it is used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.checked_rows import ChecksumOptions
from app.errors import MapDamagedError
from app.storage import map_files
from app.storage.map_files import open_index, write_map
from app.vision import index as index_module
from app.vision.index import HALF_BYTES, TAIL_BYTES, GlobalIndex, IndexOptions
from tests.maps import map_of
from tests.scenes import pose_at

KEYFRAMES = 600
SIZE = 64
ROW_BYTES = HALF_BYTES * SIZE
BLOCK_BYTES = 1024


@pytest.fixture
def large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a map whose index is large, by limits that are small."""
    monkeypatch.setattr(
        index_module, "OPTIONS", IndexOptions(flat_keyframes=300, code_size=16, min_candidates=20)
    )
    monkeypatch.setattr(
        map_files, "CHECKSUMS", ChecksumOptions(eager_bytes=1000, index_block_bytes=BLOCK_BYTES)
    )
    artifact = map_of(
        [pose_at(float(x), 0.0) for x in range(KEYFRAMES)],
        [np.zeros((1, 3))] * KEYFRAMES,
        [np.zeros((1, 8), np.uint8)] * KEYFRAMES,
    )
    artifact = replace(artifact, metadata=replace(artifact.metadata, descriptor_size=SIZE))
    write_map(artifact, GlobalIndex.from_descriptors(described()), tmp_path / "map", tmp_path / "index")
    return tmp_path


def described() -> np.ndarray:
    vectors = np.random.default_rng(0).normal(size=(KEYFRAMES, SIZE)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def opened(folder: Path) -> GlobalIndex:
    return open_index(MapArtifact.open(folder / "map"), folder / "index")


def flip(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0xFF
    path.write_bytes(data)


def byte_of(folder: Path, keyframe: int) -> int:
    """Return where the whole descriptor of a keyframe begins."""
    return (folder / "index").stat().st_size - TAIL_BYTES - (KEYFRAMES - keyframe) * ROW_BYTES


def test_a_whole_index_finds_its_keyframes(large: Path) -> None:
    index = opened(large)
    assert not index.is_exact
    for row in range(0, KEYFRAMES, 50):
        assert index.search(described()[row], 3)[0][0] == row
    np.testing.assert_allclose(index.descriptors, described(), atol=1e-3)
    assert not index.is_damaged


@pytest.mark.parametrize("place", ["header", "codes", "tail"])
def test_all_that_each_search_reads_is_verified_at_once(large: Path, place: str) -> None:
    size = (large / "index").stat().st_size
    flip(large / "index", {"header": 8, "codes": byte_of(large, 0) - 100, "tail": size - 1}[place])
    with pytest.raises(MapDamagedError, match="index is damaged"):
        opened(large)


def test_a_damaged_descriptor_is_never_used(large: Path) -> None:
    flip(large / "index", byte_of(large, 500))
    index = opened(large)
    # One of another block is as it was.
    assert np.allclose(index.descriptor(300), described()[300], atol=1e-3)
    assert not index.is_damaged
    with pytest.raises(MapDamagedError):
        index.search(described()[500], 3)
    assert index.is_damaged
    # From then on nothing of the file is trusted.
    for use in (lambda: index.descriptor(300), lambda: index.descriptors):
        with pytest.raises(MapDamagedError):
            use()


@pytest.mark.parametrize("cut", [1, BLOCK_BYTES, 10**9])
def test_a_file_that_is_cut_short_is_refused(large: Path, cut: int) -> None:
    data = (large / "index").read_bytes()
    (large / "index").write_bytes(data[: max(0, len(data) - cut)])
    with pytest.raises(MapDamagedError):
        opened(large)


def test_a_small_index_is_verified_whole(large: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "CHECKSUMS", ChecksumOptions())
    artifact = MapArtifact.open(large / "map")
    write_map(artifact, GlobalIndex.from_descriptors(described()), large / "small", large / "index")
    small = MapArtifact.open(large / "small")
    assert small.index_checksums is not None
    assert small.index_checksums.blocks is None
    assert len(open_index(small, large / "index")) == KEYFRAMES
    flip(large / "index", byte_of(large, 500))
    with pytest.raises(MapDamagedError, match="another checksum"):
        open_index(small, large / "index")
