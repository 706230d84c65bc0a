"""The packed map: what is written is read back bit by bit, and nothing else passes for a map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.engine.maps.artifact import MAGIC, MapArrays, MapArtifact, MapArtifactError, MapMetadata
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
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
        MapMetadata(
            features="orb",
            descriptor_sha256="ab" * 32,
            descriptor_size=4096,
            cameras=cameras,
            keyframe_names=names,
        ),
        arrays,
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
        with pytest.raises(MapArtifactError):
            MapArtifact.open(written)


def test_a_missing_file_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapArtifactError):
        MapArtifact.open(tmp_path / "none")
    for data in (b"x" * 1000, MAGIC + b"\xff" * 100, MAGIC + bytes(100), b"RFMAP999" + bytes(1000)):
        (tmp_path / "map").write_bytes(data)
        with pytest.raises(MapArtifactError):
            MapArtifact.open(tmp_path / "map")


def test_a_damaged_header_is_refused(written: Path) -> None:
    whole = written.read_bytes()
    length = int.from_bytes(whole[8:16], "little")
    header = json.loads(whole[16 : 16 + length])

    def with_header(changed: object) -> bytes:
        text = json.dumps(changed).encode()
        return MAGIC + len(text).to_bytes(8, "little") + text + whole[16 + length :]

    arrays, metadata = header["arrays"], header["metadata"]
    damaged: list[object] = [
        [],
        {},
        {"arrays": arrays},
        {"arrays": {}, "metadata": metadata},
        {"arrays": {**arrays, "more": arrays["offsets"]}, "metadata": metadata},
        {"arrays": arrays, "metadata": {**metadata, "cameras": [{"model": "PINHOLE"}]}},
        {"arrays": {**arrays, "offsets": {**arrays["offsets"], "offset": 10**9}}, "metadata": metadata},
        {"arrays": {**arrays, "offsets": {**arrays["offsets"], "offset": -(10**9)}}, "metadata": metadata},
        {"arrays": {**arrays, "offsets": {**arrays["offsets"], "shape": [-1]}}, "metadata": metadata},
        {"arrays": {**arrays, "offsets": {**arrays["offsets"], "dtype": "|O"}}, "metadata": metadata},
    ]
    for changed in damaged:
        written.write_bytes(with_header(changed))
        with pytest.raises(MapArtifactError):
            MapArtifact.open(written)
