"""ROS 2 bags whose files rosbag2 packed by zstd are those that it packed."""

from __future__ import annotations

from pathlib import Path

import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from app.errors import InvalidScanError
from app.importers.archives.archive import names_in_archive
from app.importers.frames import ScanOptions
from app.importers.recognition import recognised
from app.importers.registry import find_scan, open_scan
from app.importers.unpack_scan import unpack_scan
from bench.formats import recordings
from bench.formats.frames import WrittenScan
from bench.tests.formats.scans import CAMERA, packed, tiny_scan
from bench.tests.formats.test_formats import assert_is

STORAGES = {".db3": StoragePlugin.SQLITE3, ".mcap": StoragePlugin.MCAP}


def packed_bag(folder: Path, suffix: str, scan: WrittenScan | None = None) -> Path:
    """Write a bag with its metadata and return its only file."""
    written = recordings.ros2(STORAGES[suffix], scan or tiny_scan(), folder, compression=CompressionMode.FILE)
    (path,) = written.glob("*.zstd")
    assert path.name == f"{folder.name}{suffix}.zstd"
    return path


@pytest.mark.parametrize("suffix", STORAGES)
def test_a_bag_with_its_metadata_in_an_archive(tmp_path: Path, suffix: str) -> None:
    folder = packed_bag(tmp_path / "walk", suffix).parent
    archive = packed(folder, tmp_path / "a.zip", "my scan/")
    (told,) = recognised(names_in_archive(archive))
    assert (told.format, told.folder, told.missing) == ("ros-bag", "my scan", ())
    root = unpack_scan(archive, tmp_path / "unpacked")
    assert find_scan(root) == (root, "ros-bag")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    scan = open_scan(root, None, ScanOptions(scratch=scratch))
    assert_is(scan, tiny_scan())
    assert scan.has_depth
    # What was unpacked is needed no longer than it is read.
    assert not [path for path in scratch.rglob("*") if path.suffix == suffix]


@pytest.mark.parametrize("suffix", STORAGES)
def test_the_file_alone_is_a_recording(tmp_path: Path, suffix: str) -> None:
    path = packed_bag(tmp_path / "walk", suffix).rename(tmp_path / "upload")
    assert names_in_archive(path) == [f"recording{suffix}.zstd"]
    (told,) = recognised(names_in_archive(path))
    assert told.format == "ros-bag"
    assert_is(open_scan(unpack_scan(path, tmp_path / "unpacked")), tiny_scan())


def test_packed_parts_of_a_split_bag_are_one_recording(tmp_path: Path) -> None:
    scan = tiny_scan()
    (tmp_path / "bag").mkdir()
    for number, frames in enumerate((scan.frames[:3], scan.frames[3:])):
        path = packed_bag(tmp_path / f"half{number}", ".mcap", WrittenScan(CAMERA, frames, scan.down))
        # Packed by hand, the suffix is shorter.
        path.rename(tmp_path / f"bag/walk_{number}.mcap.{('zstd', 'zst')[number]}")
    assert_is(open_scan(tmp_path / "bag"), scan)


def test_messages_that_are_packed_one_by_one(tmp_path: Path) -> None:
    folder = recordings.ros2(
        StoragePlugin.MCAP, tiny_scan(), tmp_path / "walk", compression=CompressionMode.MESSAGE
    )
    assert_is(open_scan(folder), tiny_scan())


@pytest.mark.parametrize("suffix", STORAGES)
def test_a_packed_bag_that_was_cut_short(tmp_path: Path, suffix: str) -> None:
    path = packed_bag(tmp_path / "walk", suffix)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(InvalidScanError, match=r"walk\.\w+\.zstd is cut short: copy it again"):
        open_scan(path.parent)


def test_what_is_packed_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "walk.mcap.zstd").write_bytes(zstd.compress(b"no bag" * 1000))
    with pytest.raises(InvalidScanError, match="can't be read as a ROS bag"):
        open_scan(tmp_path)


def test_a_bag_that_unpacks_to_more_than_any_scan(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap.zstd"
    with zstd.open(path, "wb") as file:
        file.write(b"\x89MCAP0\r\n")
        for _ in range(60):
            file.write(bytes(1024 * 1024))
    assert path.stat().st_size < 100_000
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with pytest.raises(InvalidScanError, match="unpacks to more than 200 times its size"):
        open_scan(tmp_path, None, ScanOptions(scratch=scratch))
    assert not [found for found in scratch.rglob("*") if found.is_file()]
