"""Scans of colour images and poses alone: they are read, and say that points will be triangulated."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.importers.frames import Scan
from app.importers.registry import open_scan
from tests.importers.scans import HEIGHT, WIDTH, write_color, write_tum


def assert_has_no_depth(scan: Scan, frames: int) -> None:
    assert len(scan.frames) == frames
    assert not scan.has_depth
    assert any("triangulated" in note for note in scan.notes)
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m.shape == (HEIGHT, WIDTH)
    assert not depth_m.any()


def test_a_tum_scan_of_colour_images_and_poses(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "depth.txt").unlink()
    shutil.rmtree(tmp_path / "depth")
    scan = open_scan(tmp_path)
    assert_has_no_depth(scan, 3)
    assert scan.frames[2].scan_from_camera.translation[0] == 2


def test_depth_images_without_their_list_are_not_ignored(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "depth.txt").unlink()
    with pytest.raises(InvalidScanError, match=r"depth\.txt is missing"):
        open_scan(tmp_path)


def test_nerfstudio_without_depth(tmp_path: Path) -> None:
    frames = []
    for i in range(3):
        write_color(tmp_path / f"images/{i}.png")
        matrix = np.eye(4)
        matrix[0, 3] = i
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": matrix.tolist()})
    content = {"fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "w": WIDTH, "h": HEIGHT, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    assert_has_no_depth(open_scan(tmp_path), 3)


def test_the_blank_depth_goes_with_the_scan(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "depth.txt").unlink()
    shutil.rmtree(tmp_path / "depth")
    scan = open_scan(tmp_path)
    blank = scan.frames[0].depth
    assert blank.is_file()
    del scan
    assert not blank.exists()
