"""The packed map: what is written is read back bit by bit, and nothing else passes for a map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.engine.maps import packed_file
from app.engine.maps.artifact import FileChecksums, MapArrays, MapArtifact, MapMetadata, Places
from app.engine.maps.checked_rows import (
    BlockChecker,
    CheckedRows,
    ChecksumOptions,
    checksum,
    checksums_of_blocks,
)
from app.engine.maps.packed_file import MAGIC
from app.engine.maps.surroundings import with_places
from app.errors import MapDamagedError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from tests.maps import write_without_checksums
from tests.synthetic import random_pose


def make_map(features: tuple[int, ...] = (5, 0, 7), dtype: type = np.uint8, width: int = 32) -> MapArtifact:
    rng = np.random.default_rng(3)
    poses = [random_pose(rng) for _ in features]
    total = sum(features)
    arrays = MapArrays(
        positions=np.stack([pose.translation for pose in poses]),
        quaternions=np.stack([pose.quaternion for pose in poses]),
        camera_rows=np.arange(len(features), dtype=np.int32) % 2,
        offsets=np.concatenate([[0], np.cumsum(features)]).astype(np.int64),
        keypoints_px=rng.normal(size=(total, 2)).astype(np.float32),
        points_in_world=rng.normal(size=(total, 3)).astype(np.float32),
        point_sigma_m=rng.random(total).astype(np.float32),
        distance_elsewhere=rng.random(total).astype(np.float16),
        keyframe_elsewhere=np.full(total, -1, np.int32),
        descriptors=(rng.random((total, width)) * 200).astype(dtype),
    )
    cameras = (
        Camera("PINHOLE", 640, 480, (525.0, 525.0, 319.5, 239.5)),
        Camera("OPENCV", 320, 240, (262.1, 262.2, 159.5, 119.5, -0.1, 0.01, 0.001, 0.002)),
    )
    names = tuple(f"rgb/bild № {i}.png" for i in range(len(features)))
    return MapArtifact(
        metadata=MapMetadata(
            features="orb",
            descriptor_sha256="ab" * 32,
            descriptor_size=4096,
            cameras=cameras,
            keyframe_names=names,
        ),
        arrays=arrays,
    )


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A map in a file."""
    make_map().write(tmp_path / "map")
    return tmp_path / "map"


@pytest.mark.parametrize("dtype", [np.uint8, np.float16])
@pytest.mark.parametrize("features", [(5, 0, 7), (1,), (0,)], ids=str)
def test_a_round_trip_changes_nothing(tmp_path: Path, features: tuple[int, ...], dtype: type) -> None:
    made = make_map(features, dtype)
    made.write(tmp_path / "map")
    read = MapArtifact.open(tmp_path / "map")
    assert read.metadata == made.metadata
    for name in MapArrays.__slots__:
        before, after = getattr(made.arrays, name), getattr(read.arrays, name)
        assert before.dtype == after.dtype
        assert np.array_equal(before, after)
        assert not after.flags.writeable
    assert (read.keyframe_count, read.feature_count) == (len(features), sum(features))


def test_keyframes_have_their_own_rows_pose_and_camera(written: Path) -> None:
    made, read = make_map(), MapArtifact.open(written)
    assert [read.rows(i) for i in range(3)] == [slice(0, 5), slice(5, 5), slice(5, 12)]
    assert read.camera(1) == made.metadata.cameras[1]
    assert read.camera(2) == made.metadata.cameras[0]
    expected = Pose.from_quaternion(made.arrays.positions[2], made.arrays.quaternions[2])
    assert np.allclose(read.pose(2).matrix, expected.matrix)


def test_a_map_cut_short_anywhere_is_refused(written: Path) -> None:
    whole = written.read_bytes()
    for length in [0, 1, 7, 8, 15, 16, 100, len(whole) // 2, len(whole) - 1]:
        written.write_bytes(whole[:length])
        with pytest.raises(MapDamagedError):
            MapArtifact.open(written)


def test_a_missing_file_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapDamagedError):
        MapArtifact.open(tmp_path / "none")
    for data in (
        b"x" * 1000,
        MAGIC + b"\xff" * 100,
        MAGIC + bytes(100),
        b"RFMAP002" + bytes(9),
        b"RFMAP999" + bytes(1000),
    ):
        (tmp_path / "map").write_bytes(data)
        with pytest.raises(MapDamagedError):
            MapArtifact.open(tmp_path / "map")


def with_header(whole: bytes, changed: object) -> bytes:
    """Return a file of this form with another header, whose checksum is right."""
    length = int.from_bytes(whole[8:16], "little")
    rest = whole[24 + length :]
    text = json.dumps(changed).encode()
    # The table of checksums of this map has one entry.
    described = checksum(text + rest[:8])
    return MAGIC + len(text).to_bytes(8, "little") + described.to_bytes(8, "little") + text + rest


def test_a_damaged_header_is_refused(written: Path) -> None:
    whole = written.read_bytes()
    length = int.from_bytes(whole[8:16], "little")
    header = json.loads(whole[24 : 24 + length])
    arrays, metadata = header["arrays"], header["metadata"]
    damaged: list[object] = [
        [],
        {},
        {**header, "arrays": {}},
        {**header, "arrays": {**arrays, "more": arrays["offsets"]}},
        {**header, "metadata": []},
        {**header, "metadata": {**metadata, "cameras": [{"model": "PINHOLE"}]}},
        {**header, "arrays": {**arrays, "offsets": {**arrays["offsets"], "offset": 10**9}}},
        {**header, "arrays": {**arrays, "offsets": {**arrays["offsets"], "offset": -(10**9)}}},
        {**header, "arrays": {**arrays, "offsets": {**arrays["offsets"], "shape": [-1]}}},
        {**header, "arrays": {**arrays, "offsets": {**arrays["offsets"], "dtype": "|O"}}},
        {**header, "block_bytes": 0},
        {**header, "body_bytes": -1},
    ]
    for changed in damaged:
        written.write_bytes(with_header(whole, changed))
        with pytest.raises(MapDamagedError):
            MapArtifact.open(written)


def test_a_byte_flipped_anywhere_is_found(written: Path) -> None:
    whole = written.read_bytes()
    arrays = {name: np.array(getattr(MapArtifact.open(written).arrays, name)) for name in MapArrays.__slots__}
    for place in np.random.default_rng(0).choice(len(whole), 200, replace=False):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(place) % 8
        written.write_bytes(flipped)
        try:
            read = MapArtifact.open(written)
        except MapDamagedError:
            continue
        # What has no checksum is the padding between the table and the body.
        assert all(np.array_equal(arrays[name], getattr(read.arrays, name)) for name in arrays)


def test_a_large_file_is_verified_where_it_is_read(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = make_map((50, 50, 50))
    monkeypatch.setattr(packed_file, "OPTIONS", ChecksumOptions(block_bytes=64, eager_bytes=0))
    with_places(made).write(written)
    read = MapArtifact.open(written)
    for name in MapArrays.__slots__:
        assert np.array_equal(getattr(made.arrays, name), getattr(read.arrays, name))
    whole = written.read_bytes()
    place = whole.index(np.ascontiguousarray(made.arrays.descriptors[60:61]).tobytes())
    flipped = bytearray(whole)
    flipped[place] ^= 4
    written.write_bytes(flipped)
    read = MapArtifact.open(written)
    assert np.array_equal(read.arrays.descriptors[0:20], made.arrays.descriptors[0:20])
    some = np.array([120, 3])
    assert np.array_equal(read.arrays.descriptors[some], made.arrays.descriptors[some])
    assert not read.is_damaged
    for rows in (slice(55, 65), np.array([7, 60]), np.arange(150) == 60):
        with pytest.raises(MapDamagedError):
            read.arrays.descriptors[rows]
    assert read.is_damaged
    assert read.checker is not None
    with pytest.raises(MapDamagedError):
        read.checker.check_all()


def test_a_sorted_array_that_was_changed_gives_no_wrong_row() -> None:
    keys = np.sort(np.random.default_rng(1).integers(0, 5000, 3000))
    sums = checksums_of_blocks(np.frombuffer(keys.tobytes(), np.uint8), 256)
    changed = keys.copy()
    # The middle, which each search compares with first.
    changed[1500] = -1
    for values in (keys, changed):
        was_found = False
        for side in ("left", "right"):
            for value in np.arange(-5, 5010, 7):
                checker = BlockChecker(np.frombuffer(values.tobytes(), np.uint8), sums, 256, "keys")
                rows = CheckedRows(values, 0, checker)
                try:
                    found = rows.searchsorted(np.array([value]), side)
                except MapDamagedError:
                    was_found = True
                    continue
                assert found == np.searchsorted(keys, [value], side)
        assert was_found == (values is changed)


def test_a_map_of_the_form_before_is_opened(tmp_path: Path) -> None:
    made = make_map()
    write_without_checksums(made, tmp_path / "old")
    read = MapArtifact.open(tmp_path / "old")
    assert (read.metadata, read.checker, read.places, read.index_checksums) == (
        made.metadata,
        None,
        None,
        None,
    )
    for name in MapArrays.__slots__:
        assert np.array_equal(getattr(made.arrays, name), getattr(read.arrays, name))


@pytest.mark.parametrize("blocks", [None, np.array([7, 2**64 - 1], np.uint64)], ids=["whole", "blocks"])
def test_what_opening_would_compute_is_stored(tmp_path: Path, blocks: np.ndarray | None) -> None:
    made = make_map((40, 60))
    stored = with_places(made)
    stored.write(tmp_path / "map", FileChecksums(2**63 + 1, blocks, 4096))
    read = MapArtifact.open(tmp_path / "map")
    assert stored.places is not None
    assert read.places is not None
    for name in Places.__slots__:
        assert np.array_equal(getattr(stored.places, name), getattr(read.places, name))
    assert read.index_checksums is not None
    assert read.index_checksums.whole == 2**63 + 1
    assert np.array_equal(read.index_checksums.blocks, blocks)
    axes = np.stack([pose.rotation[:, 2] for pose in made.poses()])
    assert np.allclose(read.axes(), axes, atol=1e-12)
