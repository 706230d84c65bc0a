"""Numbers that are none, or no such ones, in the files of a scan: a sentence that names the file, never an exception of
another kind, and no frame at a place that is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.importers.registry import open_scan
from tests.importers.scans import HEIGHT, WIDTH, write_color, write_seven_scenes, write_tum

CAMERA = f"1 PINHOLE {WIDTH} {HEIGHT} 60 60 31.5 23.5"
IMAGE = "1 1 0 0 0 0 0 0 1 a.png"
SENSORS = f"cam, , camera, PINHOLE, {WIDTH}, {HEIGHT}, 60, 60, 31.5, 23.5"
NO_NUMBERS = ("nan", "inf", "9" * 400, "1.5")
INTRINSIC = "60 0 31.5 0 0 60 23.5 0 0 0 1 0 0 0 0 1"


def colmap(folder: Path, camera: str = CAMERA, image: str = IMAGE) -> Path:
    write_color(folder / "images/a.png")
    (folder / "cameras.txt").write_text(camera)
    (folder / "images.txt").write_text(f"{image}\n\n")
    return folder


def kapture(folder: Path, sensors: str = SENSORS, time: str = "0") -> Path:
    write_color(folder / "sensors/records_data/a.png")
    (folder / "sensors/sensors.txt").write_text(sensors)
    (folder / "sensors/records_camera.txt").write_text(f"{time}, cam, a.png")
    (folder / "sensors/trajectories.txt").write_text("0, cam, 1, 0, 0, 0, 0, 0, 0")
    return folder


def test_the_scans_are_right_before_they_are_damaged(tmp_path: Path) -> None:
    assert len(open_scan(colmap(tmp_path / "colmap")).frames) == 1
    assert len(open_scan(kapture(tmp_path / "kapture")).frames) == 1


@pytest.mark.parametrize("word", NO_NUMBERS)
def test_ids_and_sizes_of_colmap_and_kapture_are_whole_numbers(tmp_path: Path, word: str) -> None:
    for name, camera in {"id": f"{word}{CAMERA[1:]}", "size": CAMERA.replace(str(WIDTH), word)}.items():
        with pytest.raises(InvalidScanError, match=r"cameras\.txt line 1"):
            open_scan(colmap(tmp_path / name, camera))
    with pytest.raises(InvalidScanError, match=r"images\.txt line 1"):
        open_scan(colmap(tmp_path / "image", image=IMAGE.replace(" 1 a.png", f" {word} a.png")))
    with pytest.raises(InvalidScanError, match=r"sensors\.txt: cam"):
        open_scan(kapture(tmp_path / "sensor", SENSORS.replace(str(WIDTH), word)))


@pytest.mark.parametrize("word", ["abc", "nan"])
def test_times_of_kapture_are_numbers(tmp_path: Path, word: str) -> None:
    with pytest.raises(InvalidScanError, match=r"records_camera\.txt"):
        open_scan(kapture(tmp_path, time=word))


def test_a_camera_of_a_size_that_no_image_has_is_said_in_short(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match=r"camera\.txt: .* at most 100,000 pixels") as raised:
        open_scan(write_tum(tmp_path, camera=f"PINHOLE 1e300 {HEIGHT} 60 60 31.5 23.5"))
    assert len(str(raised.value)) < 200


def test_a_pose_at_no_place_is_left_out(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    poses = (folder / "groundtruth.txt").read_text()
    (folder / "groundtruth.txt").write_text(poses.replace("0.200000 2 0 0", "0.200000 2e299 0 0"))
    scan = open_scan(folder)
    assert len(scan.frames) == 2
    assert scan.discarded == {"invalid_pose": ("rgb/0.200000.png",)}


@pytest.mark.parametrize("shift", ["nan", "inf", "-1000", "0"])
def test_a_depth_scale_that_none_can_be(tmp_path: Path, shift: str) -> None:
    write_seven_scenes(tmp_path / "data")
    keys = (f"m_calibration{kind}Intrinsic = {INTRINSIC}" for kind in ("Color", "Depth"))
    (tmp_path / "info.txt").write_text("\n".join([*keys, f"m_depthShift = {shift}"]))
    with pytest.raises(InvalidScanError, match="units of depth per metre: give depth_scale"):
        open_scan(tmp_path)


def test_one_damaged_time_does_not_set_the_unit_of_the_others(tmp_path: Path) -> None:
    times = np.arange(12) / 10
    folder = write_tum(tmp_path, times.tolist())
    listed = (folder / "depth.txt").read_text()
    (folder / "depth.txt").write_text(listed.replace("0.500000 depth", "5e12 depth"))
    scan = open_scan(folder)
    assert len(scan.frames) == 11
    assert scan.discarded == {"no_depth": ("rgb/0.500000.png",)}
