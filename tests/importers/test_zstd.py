"""Files packed by zstd: whole ones are unpacked, and damage, size and memory are bounded."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.importers.archives import zstd_files
from app.importers.archives.archive import extract_archive
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.archives.lone_recording import suffix_of_recording
from app.importers.archives.zstd_files import unpack_files

zstd = pytest.importorskip("backports.zstd")
MIB = 1024 * 1024
CONTENT = np.random.default_rng(0).integers(0, 20, 2 * MIB, dtype=np.uint8).tobytes()
MCAP = b"\x89MCAP0\r\n"
# A frame of one byte whose header states a window of 2 GB: descriptor, window, a raw block, the byte.
HUGE_WINDOW = b"\x28\xb5\x2f\xfd" + bytes([0, (31 - 10) << 3]) + b"\x09\0\0" + b"x"


def written(folder: Path, data: bytes, name: str = "walk_0.db3.zstd") -> Path:
    (folder / name).write_bytes(data)
    return folder / name


@pytest.mark.parametrize("frames", [1, 3])
def test_what_was_packed_is_unpacked(tmp_path: Path, frames: int) -> None:
    packed = b"".join(zstd.compress(CONTENT) for _ in range(frames))
    (path,) = unpack_files([written(tmp_path, packed)], tmp_path)
    assert path == tmp_path / "walk_0.db3"
    assert path.read_bytes() == frames * CONTENT


@pytest.mark.parametrize("cut", [5, 100, -1])
def test_a_file_cut_short_is_named(tmp_path: Path, cut: int) -> None:
    path = written(tmp_path, zstd.compress(CONTENT)[:cut])
    with pytest.raises(InvalidScanError, match=r"walk_0\.db3\.zstd is cut short"):
        unpack_files([path], tmp_path)


@pytest.mark.parametrize("at", [0, 1000])
def test_a_damaged_file_is_named(tmp_path: Path, at: int) -> None:
    data = bytearray(zstd.compress(CONTENT, options={zstd.CompressionParameter.checksum_flag: 1}))
    data[at : at + 4] = b"\xff\0\xff\0"
    with pytest.raises(InvalidScanError, match=r"walk_0\.db3\.zstd is damaged"):
        unpack_files([written(tmp_path, bytes(data))], tmp_path)


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        (ArchiveLimits(max_recording_bytes=MIB), r"has 2 MB unpacked; the limit for one file is 1 MB"),
        (ArchiveLimits(max_total_bytes=3 * MIB), r"unpacks to more than 3 MB, the limit"),
        (ArchiveLimits(ratio_free_bytes=MIB, max_ratio=1.5), r"unpacks to more than 1\.5 times its size"),
    ],
)
def test_more_than_the_limits_is_refused_while_unpacking(
    tmp_path: Path, limits: ArchiveLimits, said: str
) -> None:
    data = zstd.compress(CONTENT)
    paths = [written(tmp_path, data, f"walk_{number}.mcap.zstd") for number in range(2)]
    with pytest.raises(InvalidScanError, match=said):
        unpack_files(paths, tmp_path, limits)


def test_memory_is_bounded(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match="needs more than 64 MB of memory"):
        unpack_files([written(tmp_path, HUGE_WINDOW)], tmp_path)
    # The window of the strongest usual preset is read.
    small = zstd.compress(CONTENT, options={zstd.CompressionParameter.window_log: 23})
    unpack_files([written(tmp_path, small)], tmp_path)


def bag_of_sqlite(path: Path) -> bytes:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE topics (id INTEGER)")
    connection.close()
    return path.read_bytes()


def test_packed_bags_are_known_by_what_they_hold(tmp_path: Path) -> None:
    path = written(tmp_path, zstd.compress(MCAP + CONTENT), "upload")
    assert suffix_of_recording(path) == ".mcap.zstd"
    root = extract_archive(path, tmp_path / "out")
    assert [child.name for child in root.iterdir()] == ["recording.mcap.zstd"]
    path.write_bytes(zstd.compress(bag_of_sqlite(tmp_path / "bag")))
    assert suffix_of_recording(path) == ".db3.zstd"


@pytest.mark.parametrize(
    "data", [zstd.compress(b"a tar, perhaps"), zstd.compress(MCAP + CONTENT)[:20], HUGE_WINDOW]
)
def test_anything_else_that_is_packed_is_refused(tmp_path: Path, data: bytes) -> None:
    path = written(tmp_path, data, "upload")
    assert suffix_of_recording(path) is None
    with pytest.raises(InvalidScanError, match="compressed by zstd"):
        extract_archive(path, tmp_path / "out")


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, zstd.compress(MCAP + CONTENT))
    monkeypatch.setattr(zstd_files, "_LIBRARY", "a.module.that.is.not.there")
    assert suffix_of_recording(path) is None
    with pytest.raises(InvalidScanError, match=r"pip install 'roomfix\[scans\]'"):
        unpack_files([path], tmp_path)
