"""The frames of every format without their depth: the same pictures, poses and camera, and no depth."""

from __future__ import annotations

import sqlite3
import struct
import zipfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from app.errors import InvalidScanError
from app.importers.archives.archive import names_in_archive
from app.importers.recognition import recognised
from app.importers.registry import FORMATS, find_scan, open_scan
from bench.formats import layouts, phones, recordings
from bench.formats.frames import Writer
from bench.tests.formats.scans import FRAMES, OUTER_FOLDERS, packed, tiny_scan
from bench.tests.formats.test_formats import FORMAT_OF, assert_is, folder_of
from tests.importers.scans import assert_has_no_depth

# Takes the depth of some frames, or of all, out of what a writer wrote.
Remover = Callable[[Path, int], Path]


def files_of(pattern: str) -> Remover:
    """Return the remover of the first files of a pattern below a folder."""

    def remove(folder: Path, count: int) -> Path:
        for path in sorted(folder.rglob(pattern))[:count]:
            path.unlink()
        return folder

    return remove


def of_database(path: Path, count: int) -> Path:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE Data SET depth = NULL WHERE id <= ?", (count,))
    return path


def of_record3d(path: Path, count: int) -> Path:
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    out = {f"rgbd/{i}.{suffix}" for i in range(count) for suffix in ("depth", "conf")}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            if name not in out:
                archive.writestr(name, data)
    return path


def of_sens(path: Path, count: int) -> Path:
    """Cut the bytes of the first frames' depth out of a recording."""
    data = path.read_bytes()
    (name,) = struct.unpack_from("<Q", data, 4)
    at = 12 + name + 4 * 64 + 8 + 16 + 4 + 8
    pieces = [data[:at]]
    for number in range(FRAMES):
        color, depth = struct.unpack_from("<2Q", data, at + 80)
        kept = 0 if number < count else depth
        pieces += [
            data[at : at + 80],
            struct.pack("<2Q", color, kept),
            data[at + 96 : at + 96 + color + kept],
        ]
        at += 96 + color + depth
    path.write_bytes(b"".join([*pieces, data[at:]]))
    return path


CASES: dict[str, tuple[Writer, Remover]] = {
    "ICL-NUIM": (layouts.icl_nuim, files_of("depth/*.png")),
    "7-Scenes": (layouts.seven_scenes, files_of("*.depth.png")),
    "12-Scenes": (layouts.twelve_scenes, files_of("*.depth.png")),
    "ScanNet, extracted": (layouts.scannet, files_of("depth/*.png")),
    "ScanNet .sens": (recordings.sens, of_sens),
    "Open3D, Redwood": (layouts.redwood, files_of("depth/*.png")),
    "nerfstudio": (layouts.nerfstudio, files_of("depth/*.png")),
    "kapture": (layouts.kapture, files_of("tof/*.depth")),
    "COLMAP text": (layouts.colmap_text, files_of("depth/*.png")),
    "RTAB-Map .db": (recordings.rtabmap, of_database),
    "RTAB-Map export": (layouts.rtabmap_export, files_of("rtabmap_depth/*.png")),
    "Polycam raw": (phones.polycam, files_of("depth/*.png")),
    "Stray Scanner": (phones.stray_scanner, files_of("depth/*.png")),
    "Record3D, plain": (phones.record3d_plain, of_record3d),
    "3D Scanner App": (phones.scanner_app, files_of("depth_*.png")),
    "ARKitScenes": (phones.arkit_scenes, files_of("lowres_depth/*.png")),
}


def written(name: str, target: Path, count: int) -> Path:
    write, remove = CASES[name]
    return remove(write(tiny_scan(), target), count)


@pytest.mark.parametrize("name", CASES)
def test_without_any_depth_it_is_the_same_scan_without_depth(tmp_path: Path, name: str) -> None:
    sent = written(name, tmp_path / "written/scan", FRAMES)
    # As an archive: folders in which nothing is left are not in it.
    archive = packed(sent, tmp_path / "scan.zip", OUTER_FOLDERS[1])
    (told,) = recognised(names_in_archive(archive))
    assert (told.format, told.missing) == (FORMAT_OF[name], ())
    folder = folder_of(archive, tmp_path)
    assert find_scan(folder) == (folder, FORMAT_OF[name])
    assert not [
        other
        for other in FORMATS
        if other not in (FORMAT_OF[name], "7scenes") and FORMATS[other].detect(folder)
    ]
    scan = open_scan(folder)
    assert_is(scan, tiny_scan())
    assert_has_no_depth(scan, FRAMES)


@pytest.mark.parametrize("name", [name for name in CASES if name != "Open3D, Redwood"])
def test_frames_that_alone_lack_depth_are_left_out(tmp_path: Path, name: str) -> None:
    folder = folder_of(written(name, tmp_path / "scan", 2), tmp_path)
    scan = open_scan(folder)
    assert scan.has_depth
    assert not any("triangulated" in note for note in scan.notes)
    left = sum((scan.discarded.get(reason, ()) for reason in ("no_depth", "missing_file")), ())
    assert (len(left), len(scan.frames)) == (2, FRAMES - 2)


def test_images_that_are_paired_by_their_order_must_be_as_many(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match="5 poses for 5 colour and 3 depth images"):
        open_scan(written("Open3D, Redwood", tmp_path / "scan", 2))
    folder = written("Open3D, Redwood", tmp_path / "none", FRAMES)
    (folder / "color/000003.jpg").unlink()
    with pytest.raises(InvalidScanError, match="5 poses for 4 colour images"):
        open_scan(folder)


@pytest.mark.parametrize("bag", ["1", "2"])
def test_a_bag_without_a_topic_of_depth(tmp_path: Path, bag: str) -> None:
    kind = replace(recordings.REALSENSE, depth_name="infra_left")
    target = tmp_path / "scan"
    scan = tiny_scan()
    sent = (
        recordings.ros1(scan, target, kind)
        if bag == "1"
        else recordings.ros2(StoragePlugin.MCAP, scan, target, kind)
    )
    found = open_scan(folder_of(sent, tmp_path))
    assert_is(found, scan)
    assert_has_no_depth(found, FRAMES)


def test_a_header_of_sens_says_nothing_of_depth_that_is_not_there(tmp_path: Path) -> None:
    path = written("ScanNet .sens", tmp_path / "scan", FRAMES)
    data = bytearray(path.read_bytes())
    (name,) = struct.unpack_from("<Q", data, 4)
    at = 12 + name + 4 * 64
    struct.pack_into("<i", data, at + 4, -1)
    struct.pack_into("<2If", data, at + 16, 0, 0, 0.0)
    path.write_bytes(data)
    scan = open_scan(folder_of(path, tmp_path))
    assert_is(scan, tiny_scan())
    assert_has_no_depth(scan, FRAMES)


@pytest.mark.parametrize(
    ("offset", "value", "said"),
    [
        (4, struct.pack("<i", -1), "a compression that is not read"),
        (16, struct.pack("<I", 0), "depth of 0 x 240 pixels"),
        (24, struct.pack("<f", 0.0), "0.0 units per metre"),
    ],
)
def test_a_header_of_sens_that_contradicts_its_depth(
    tmp_path: Path, offset: int, value: bytes, said: str
) -> None:
    path = written("ScanNet .sens", tmp_path / "scan", 0)
    data = bytearray(path.read_bytes())
    (name,) = struct.unpack_from("<Q", data, 4)
    at = 12 + name + 4 * 64 + offset
    data[at : at + len(value)] = value
    path.write_bytes(data)
    with pytest.raises(InvalidScanError, match=said):
        open_scan(folder_of(path, tmp_path))


def test_a_calibration_alone_makes_no_export_of_rtabmap(tmp_path: Path) -> None:
    folder = layouts.rtabmap_export(tiny_scan(), tmp_path / "scan")
    for path in [*(folder / "rtabmap_depth").iterdir(), *(folder / "rtabmap_calib").iterdir()]:
        path.unlink()
    for name in ("rtabmap_depth", "rtabmap_calib"):
        (folder / name).rmdir()
    (folder / "config.yaml").write_text("camera: {fps: 30}\n")
    assert not FORMATS["rtabmap-export"].detect(folder)
