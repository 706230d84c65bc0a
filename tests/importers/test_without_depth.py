"""Scans of colour images and poses alone: they are read, and say that points will be triangulated."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from tests.importers.scans import (
    CAMERA_LINE,
    HEIGHT,
    INTRINSICS,
    WIDTH,
    assert_has_no_depth,
    write_color,
    write_depth,
    write_seven_scenes,
    write_tum,
)


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


def as_associations(folder: Path) -> None:
    """Replace both lists by one that names the images of both."""
    times = [line.split()[0] for line in (folder / "rgb.txt").read_text().splitlines()[1:]]
    rows = [f"{time} rgb/{time}.png {time} depth/{time}.png\n" for time in times]
    (folder / "associations.txt").write_text("".join(rows))
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).unlink()


@pytest.mark.parametrize("one_list", [False, True])
def test_a_tum_scan_whose_lists_name_depth_that_was_taken_out(tmp_path: Path, one_list: bool) -> None:
    write_tum(tmp_path)
    if one_list:
        as_associations(tmp_path)
    (tmp_path / "depth/0.100000.png").unlink()
    some = open_scan(tmp_path)
    assert some.has_depth
    assert some.discarded == {"missing_file": ("rgb/0.100000.png",)}
    shutil.rmtree(tmp_path / "depth")
    scan = open_scan(tmp_path)
    assert_has_no_depth(scan, 3)
    assert scan.camera.params == INTRINSICS
    assert scan.frames[2].scan_from_camera.translation[0] == 2


@pytest.mark.parametrize("name", ["depth_png", "d", "rgb/depth"])
def test_depth_that_a_tum_list_names_wrongly_is_not_ignored(tmp_path: Path, name: str) -> None:
    write_tum(tmp_path)
    (tmp_path / "depth").rename(tmp_path / name)
    with pytest.raises(InvalidScanError, match=r"depth/0\.000000\.png of depth\.txt line 2"):
        open_scan(tmp_path)


def test_icl_nuim_without_depth_keeps_its_axes(tmp_path: Path) -> None:
    write_tum(tmp_path)
    as_associations(tmp_path)
    rows = (tmp_path / "groundtruth.txt").read_text().replace(" 0 0 0 0 0 1", " 0 1 0 0 0 1")
    (tmp_path / "livingRoom0.gt.freiburg").write_text(rows)
    (tmp_path / "groundtruth.txt").unlink()
    with_depth = open_scan(tmp_path)
    shutil.rmtree(tmp_path / "depth")
    scan = open_scan(tmp_path)
    assert_has_no_depth(scan, 3)
    for frame, other in zip(scan.frames, with_depth.frames, strict=True):
        np.testing.assert_allclose(frame.scan_from_camera.matrix, other.scan_from_camera.matrix)


@pytest.mark.parametrize("sequence", ["", "seq-01"])
def test_seven_scenes_without_depth(tmp_path: Path, sequence: str) -> None:
    folder = write_seven_scenes(tmp_path / sequence)
    (tmp_path / "camera.txt").write_text(CAMERA_LINE)
    with_depth = open_scan(tmp_path)
    for path in folder.glob("*.depth.png"):
        path.unlink()
    scan = open_scan(tmp_path)
    assert_has_no_depth(scan, 3)
    assert (scan.camera, scan.discarded) == (with_depth.camera, {})
    for frame, other in zip(scan.frames, with_depth.frames, strict=True):
        np.testing.assert_allclose(frame.scan_from_camera.matrix, other.scan_from_camera.matrix)


def test_a_depth_camera_means_nothing_without_depth(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    for path in tmp_path.glob("*.depth.png"):
        path.unlink()
    camera = CameraHint(values=INTRINSICS)
    scan = open_scan(tmp_path, None, ScanOptions(camera=camera, depth_camera=camera))
    assert_has_no_depth(scan, 3)


def test_a_frame_of_seven_scenes_without_its_depth_is_left_out(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    (tmp_path / "camera.txt").write_text(CAMERA_LINE)
    (tmp_path / "frame-000001.depth.png").unlink()
    scan = open_scan(tmp_path)
    assert scan.has_depth
    assert scan.discarded == {"no_depth": ("frame-000001.color.png",)}
    for path in tmp_path.glob("*.depth.png"):
        path.rename(path.with_suffix(".dat"))
    with pytest.raises(InvalidScanError, match=r"3 no_depth.*frame-000000\.depth\.png is missing"):
        open_scan(tmp_path)


TWELVE = """m_depthShift = 1000
m_calibrationColorIntrinsic = 60 0 31.5 0 0 60 23.5 0 0 0 1 0 0 0 0 1
"""


def test_twelve_scenes_without_depth_needs_no_camera_for_it(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "data")
    (tmp_path / "info.txt").write_text(TWELVE)
    with pytest.raises(InvalidScanError, match="m_calibrationDepthIntrinsic must be 16 numbers"):
        open_scan(tmp_path)
    for path in folder.glob("*.depth.png"):
        path.unlink()
    scan = open_scan(tmp_path)
    assert_has_no_depth(scan, 3)
    assert scan.camera.params == INTRINSICS


def test_pictures_of_another_size_are_refused_without_depth_too(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    (tmp_path / "camera.txt").write_text(CAMERA_LINE)
    for path in tmp_path.glob("*.depth.png"):
        path.unlink()
    write_color(tmp_path / "frame-000002.color.png", 2 * WIDTH, HEIGHT)
    with pytest.raises(InvalidScanError, match=r"frame-000002\.color\.png has 128 x 48 pixels"):
        open_scan(tmp_path)


def test_hidden_files_are_no_depth(tmp_path: Path) -> None:
    write_tum(tmp_path)
    shutil.rmtree(tmp_path / "depth")
    (tmp_path / "depth.txt").unlink()
    write_depth(tmp_path / "depth/0.png")
    (tmp_path / "depth/0.png").rename(tmp_path / "depth/._0.png")
    assert_has_no_depth(open_scan(tmp_path), 3)
