"""The same frames in each format become the same scan, sent as they are on a phone or a disk."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.frame_images import frame_rgb
from app.errors import InvalidScanError
from app.importers.archives.archive import names_in_archive
from app.importers.frames import Scan
from app.importers.recognition import recognised
from app.importers.registry import FORMATS, find_scan, open_scan
from app.importers.unpack_scan import unpack_scan
from bench.formats.frames import WITHOUT_DEPTH, WrittenScan
from bench.formats.recordings import rtabmap
from bench.formats.writers import WRITERS
from bench.tests.formats.scans import CAMERA, FRAMES, HEIGHT, OUTER_FOLDERS, WIDTH, packed, tiny_scan

FORMAT_OF = {
    "TUM": "tum",
    "TUM, ORB-SLAM trajectories": "tum",
    "ICL-NUIM": "tum",
    "7-Scenes": "7scenes",
    "12-Scenes": "12scenes",
    "ScanNet, extracted": "scannet",
    "ScanNet .sens": "sens",
    "Open3D, Redwood": "redwood",
    "nerfstudio": "nerfstudio",
    "kapture": "kapture",
    "COLMAP text": "colmap",
    "COLMAP binary": "colmap",
    "RTAB-Map .db": "rtabmap",
    "RTAB-Map export": "rtabmap-export",
    "ROS 1 .bag": "ros-bag",
    "ROS 2 .db3": "ros-bag",
    "ROS 2 .mcap": "ros-bag",
    "Polycam raw": "polycam",
    "Stray Scanner": "stray-scanner",
    "Record3D, LZFSE": "record3d",
    "Record3D, plain": "record3d",
    "3D Scanner App": "3d-scanner-app",
    "ARKitScenes": "arkitscenes",
    "TUM, no depth": "tum",
    "COLMAP binary, no depth": "colmap",
    "Stray Scanner, no depth": "stray-scanner",
    "kapture, no depth": "kapture",
}
PHONES = (
    "Polycam raw",
    "Stray Scanner",
    "Record3D, LZFSE",
    "Record3D, plain",
    "3D Scanner App",
    "ARKitScenes",
)


def folder_of(written: Path, tmp_path: Path) -> Path:
    """Return the folder that a server would read: a file goes through the unpacking of uploads."""
    return written if written.is_dir() else unpack_scan(written, tmp_path / "unpacked")


def assert_is(scan: Scan, expected: WrittenScan) -> None:
    assert scan.discarded == {}
    assert len(scan.frames) == FRAMES
    assert scan.camera.params[:4] == pytest.approx(CAMERA.params[:4], abs=1e-4)
    # The world may have been turned on the way, by one rotation for all frames.
    first = expected.frames[0].scan_from_camera
    turn = scan.frames[0].scan_from_camera @ first.inverse()
    assert np.abs(turn.translation).max() < 1e-4
    for frame, written in zip(scan.frames, expected.frames, strict=True):
        np.testing.assert_allclose(
            frame.scan_from_camera.matrix, (turn @ written.scan_from_camera).matrix, atol=2e-6
        )
    assert (np.diff([frame.timestamp_s for frame in scan.frames]) > 0).all()
    if scan.gravity is not None:
        np.testing.assert_allclose(turn.rotation.T @ scan.gravity, expected.down, atol=1e-6)


def test_all_writers_have_a_format_and_all_formats_a_writer() -> None:
    assert set(FORMAT_OF) == set(WRITERS)
    assert set(FORMAT_OF.values()) == set(FORMATS)


@pytest.mark.parametrize("name", WRITERS)
def test_the_same_scan_in_every_format(tmp_path: Path, name: str) -> None:
    expected = tiny_scan()
    folder = folder_of(WRITERS[name](expected, tmp_path / "scan"), tmp_path)
    scan = open_scan(folder)
    assert_is(scan, expected)
    assert scan.has_depth == (WITHOUT_DEPTH not in name)
    for number in (0, FRAMES - 1) if scan.has_depth else ():
        depth_m = scan.depth_m(scan.frames[number])
        inside = np.s_[HEIGHT // 4 : -HEIGHT // 4, WIDTH // 4 : -WIDTH // 4]
        np.testing.assert_allclose(depth_m[inside], expected.frames[number].depth_m[inside], atol=2e-3)
    assert open_scan(folder, FORMAT_OF[name]).camera == scan.camera
    others = [other for other in FORMATS if other != FORMAT_OF[name]]
    assert not [other for other in others if FORMATS[other].detect(folder) and other not in ("7scenes",)]


@pytest.mark.parametrize("name", WRITERS)
def test_folders_around_a_scan_do_not_matter(tmp_path: Path, name: str) -> None:
    written = WRITERS[name](tiny_scan(), tmp_path / "written/scan")
    for number, outer in enumerate(OUTER_FOLDERS):
        archive = packed(written, tmp_path / f"{number}.zip", outer)
        (told,) = recognised(names_in_archive(archive))
        assert (told.format, told.missing) == (FORMAT_OF[name], ())
        assert told.folder.removesuffix("seq-01") == (outer if name == "7-Scenes" else outer.rstrip("/"))
        root = unpack_scan(archive, tmp_path / f"unpacked-{number}")
        assert find_scan(root) == (root, FORMAT_OF[name])
        assert find_scan(root, FORMAT_OF[name]) == (root, FORMAT_OF[name])
    assert_is(open_scan(root), tiny_scan())


@pytest.mark.parametrize("name", PHONES)
def test_phones_say_which_way_is_down(tmp_path: Path, name: str) -> None:
    scan = open_scan(folder_of(WRITERS[name](tiny_scan(), tmp_path / "scan"), tmp_path))
    assert scan.gravity is not None


def test_depth_of_low_confidence_is_left_out(tmp_path: Path) -> None:
    expected = tiny_scan()
    hole = expected.frames[0].depth_m.copy()
    hole[:40] = 0.0
    frames = tuple(
        type(frame)(frame.time_s, frame.bgr, hole, frame.scan_from_camera) for frame in expected.frames
    )
    for name in ("Polycam raw", "Stray Scanner", "3D Scanner App"):
        folder = WRITERS[name](WrittenScan(CAMERA, frames, expected.down), tmp_path / name)
        # Depth where the confidence is low: it must not be used.
        for path in sorted(folder.rglob("depth*.png")) + sorted((folder / "depth").rglob("*.png")):
            _fill(path)
        for path in sorted(folder.rglob("keyframes/depth/*.png")):
            _fill(path)
        scan = open_scan(folder)
        assert not scan.depth_m(scan.frames[0])[:30].any()
        assert scan.depth_m(scan.frames[0])[120, 160] == pytest.approx(2.0)


def _fill(path: Path) -> None:
    import cv2

    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    raw[:] = 2000
    cv2.imwrite(str(path), raw)


def test_floats_in_a_database_of_rtabmap(tmp_path: Path) -> None:
    expected = tiny_scan()
    scan = open_scan(folder_of(rtabmap(expected, tmp_path / "scan", depth_as_floats=True), tmp_path))
    assert_is(scan, expected)
    np.testing.assert_allclose(scan.depth_m(scan.frames[1]), expected.frames[1].depth_m, atol=6e-4)


@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_file_is_one_clear_sentence(tmp_path: Path, name: str) -> None:
    """A file of each kind, cut in half, emptied, and of other bytes: a sentence, never another error, and frames that
    are left can be read."""
    written = WRITERS[name](tiny_scan(), tmp_path / "scan")
    for number, path in enumerate(_of_each_kind(written)):
        whole = path.read_bytes()
        for kind, data in _damaged(whole).items():
            path.write_bytes(data)
            said = _sentence_of(written, tmp_path / f"{kind}-{number}")
            assert said is None or re.fullmatch(r"[^\n]{21,}\.", said), said
        path.write_bytes(whole)


def _sentence_of(written: Path, unpacked: Path) -> str | None:
    try:
        _read_all(open_scan(folder_of(written, unpacked)))
    except InvalidScanError as error:
        return str(error)
    return None


def _of_each_kind(written: Path) -> list[Path]:
    """Return the first file of each folder and suffix, and all that lie beside pictures."""
    files = [written] if written.is_file() else sorted(path for path in written.rglob("*") if path.is_file())
    pictures = {".jpg", ".png", ".depth", ".conf"}
    first = {
        (path.parent, path.suffix if path.suffix in pictures else path.name): path for path in files[::-1]
    }
    return [path for path in list(first.values())[::-1][:8] if path.stat().st_size]


def _damaged(whole: bytes) -> dict[str, bytes]:
    other = np.random.default_rng(1).bytes(3000)
    return {"half": whole[: len(whole) // 2], "empty": b"", "other": other}


def _read_all(scan: Scan) -> None:
    for frame in scan.frames:
        frame_rgb(scan, frame)
        if scan.has_depth:
            scan.depth_m(frame)
