"""A TUM scan without groundtruth.txt: poses by uniform motion, or a sentence that says what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.errors import InvalidScanError
from app.geometry.uniform_motion import UniformMotion
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from tests.importers.scans import write_seven_scenes, write_tum

MOTION = UniformMotion((1.0, 2.0, 1.5), 0.5, 90.0, 10.0)


def unposed(folder: Path, times: list[float] | None = None) -> Path:
    write_tum(folder, times)
    (folder / "groundtruth.txt").unlink()
    return folder


def tum(folder: Path) -> Scan:
    return open_scan(folder, "tum", ScanOptions(motion=MOTION))


def test_frame_by_frame_the_camera_walks_on(tmp_path: Path) -> None:
    scan = tum(unposed(tmp_path, [5.0, 5.1, 5.2, 5.3]))
    places = [frame.scan_from_camera.translation.tolist() for frame in scan.frames]
    assert places == [pytest.approx([1.0, 2.0 + 0.05 * n, 1.5]) for n in range(4)]
    # The walk's frame stands upright, whatever the scan's own was.
    assert scan.gravity == (0.0, 0.0, -1.0)


def test_a_frame_that_is_left_out_still_counts_as_time(tmp_path: Path) -> None:
    folder = unposed(tmp_path, [0.0, 0.1, 0.2, 0.3])
    (folder / "rgb/0.100000.png").unlink()
    scan = tum(folder)
    assert [round(float(f.scan_from_camera.translation[1]), 6) for f in scan.frames] == [2.0, 2.1, 2.15]
    assert scan.discarded == {"missing_file": ("rgb/0.100000.png",)}


def test_without_a_stated_motion_the_poses_are_missing(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match=r"groundtruth\.txt is missing.*start, speed_m_s"):
        open_scan(unposed(tmp_path), "tum")


def test_a_scan_with_poses_of_its_own_keeps_them(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match="poses of its own"):
        tum(write_tum(tmp_path))


def test_the_camera_must_be_known(tmp_path: Path) -> None:
    folder = unposed(tmp_path)
    (folder / "camera.txt").unlink()
    with pytest.raises(InvalidScanError, match="camera is not known"):
        tum(folder)


def test_other_formats_have_poses(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    with pytest.raises(InvalidScanError, match="TUM layout"):
        open_scan(tmp_path, "7scenes", ScanOptions(motion=MOTION))
