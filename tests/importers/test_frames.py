"""What every format shares: telling formats apart, options, image sizes and reading depth."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from app.errors import InvalidInputError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.se3 import Pose
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from tests.importers.scans import (
    HEIGHT,
    INTRINSICS,
    WIDTH,
    write_color,
    write_depth,
    write_seven_scenes,
    write_tum,
)


@pytest.mark.parametrize("name", [None, "auto", "tum", "TUM"])
def test_tum_is_detected(tmp_path: Path, name: str | None) -> None:
    assert len(open_scan(write_tum(tmp_path), name).frames) == 3


@pytest.mark.parametrize("name", [None, "7scenes"])
def test_seven_scenes_is_detected(tmp_path: Path, name: str | None) -> None:
    options = ScanOptions(camera=CameraHint(values=INTRINSICS))
    assert len(open_scan(write_seven_scenes(tmp_path / "seq-01").parent, name, options).frames) == 3


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match="can't be told"):
        open_scan(tmp_path)
    with pytest.raises(
        InvalidScanError, match=r"not known; use auto, tum, 12scenes, 7scenes, .* or recording"
    ):
        open_scan(write_tum(tmp_path), "kitti")
    with pytest.raises(InvalidScanError, match="does not exist"):
        open_scan(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"depth_scale": 0.0}, "depth_scale"),
        ({"depth_scale": float("nan")}, "depth_scale"),
        ({"max_time_difference_s": -1.0}, "max_time_difference_s"),
        ({"color_from_depth": Pose.identity()}, "needs depth_camera"),
    ],
)
def test_options_that_cannot_be_meant(values: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        ScanOptions(**values)  # type: ignore[arg-type]


def test_numbers_get_the_size_of_the_images(tmp_path: Path) -> None:
    scan = open_scan(
        write_tum(tmp_path, camera=None), None, ScanOptions(camera=CameraHint(values=INTRINSICS))
    )
    assert scan.camera == Camera("PINHOLE", WIDTH, HEIGHT, INTRINSICS)
    with pytest.raises(InvalidScanError, match="camera: fx = 6000 px"):
        open_scan(tmp_path, None, ScanOptions(camera=CameraHint(values=(6000.0, 6000.0, 32.0, 24.0))))


def test_a_scan_goes_to_another_process(tmp_path: Path) -> None:
    scan = pickle.loads(pickle.dumps(open_scan(write_tum(tmp_path))))
    assert scan.depth_m(scan.frames[0]).shape == (HEIGHT, WIDTH)


def test_color_bytes_and_depth(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    raw = np.full((HEIGHT, WIDTH), 7500, np.uint16)
    raw[0, 0], raw[0, 1] = 0, 65535
    write_depth(folder / "depth/0.000000.png", raw)
    scan = open_scan(folder)
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m.dtype == np.float32
    assert depth_m[0, 0] == depth_m[0, 1] == 0
    np.testing.assert_array_equal(depth_m[1:], np.float32(1.5))
    assert scan.color_bytes(scan.frames[0]) == (folder / "rgb/0.000000.png").read_bytes()


def test_a_depth_scale_in_the_options_comes_first(tmp_path: Path) -> None:
    scan = open_scan(write_tum(tmp_path), None, ScanOptions(depth_scale=1000))
    assert scan.depth_m(scan.frames[0])[5, 5] == 5.0


def test_colour_of_another_size_names_both_sizes_and_the_file(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    write_color(folder / "rgb/0.100000.png", 32, 24)
    with pytest.raises(InvalidScanError, match=r"rgb/0\.100000\.png has 32 x 24 pixels.* 64 x 48"):
        open_scan(folder)
    with pytest.raises(InvalidScanError, match=r"rgb/0\.000000\.png has 64 x 48 pixels.* 128 x 96"):
        open_scan(
            folder, None, ScanOptions(camera=hint_of(Camera("PINHOLE", 128, 96, (120.0, 120.0, 63.5, 47.5))))
        )


def test_depth_of_another_shape_needs_its_camera(tmp_path: Path) -> None:
    folder = write_tum(tmp_path, [0.0])
    write_depth(folder / "depth/0.000000.png", 5000, 32, 32)
    with pytest.raises(
        InvalidScanError, match=r"0\.000000\.png has 32 x 32 pixels, its colour image .* 64 x 48"
    ):
        open_scan(folder)


def test_depth_of_another_size_has_scaled_intrinsics(tmp_path: Path) -> None:
    folder = write_tum(tmp_path, [0.0])
    write_depth(folder / "depth/0.000000.png", 5000, 32, 24)
    scan = open_scan(folder)
    assert scan.depth.camera == Camera("PINHOLE", 32, 24, (30.0, 30.0, 15.5, 11.5))
    assert any("32 x 24" in note and "scaled" in note for note in scan.notes)
    np.testing.assert_allclose(scan.depth_m(scan.frames[0])[2:-2, 2:-2], 1.0, rtol=1e-5)
    half = (30.0, 30.0, 15.5, 11.5)
    scan = open_scan(folder, None, ScanOptions(depth_camera=CameraHint(values=half)))
    assert scan.depth.camera == Camera("PINHOLE", 32, 24, half)
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m.shape == (HEIGHT, WIDTH)
    np.testing.assert_allclose(depth_m[2:-2, 2:-2], 1.0, rtol=1e-5)
    with pytest.raises(InvalidScanError, match=r"32 x 24 pixels, but the depth camera is for 64 x 48"):
        open_scan(
            folder, None, ScanOptions(depth_camera=hint_of(Camera("PINHOLE", WIDTH, HEIGHT, INTRINSICS)))
        )


def test_color_from_depth_moves_the_depth(tmp_path: Path) -> None:
    ahead = Pose(np.eye(3), np.array([0.0, 0.0, 0.25]))
    options = ScanOptions(depth_camera=CameraHint(values=INTRINSICS), color_from_depth=ahead)
    scan = open_scan(write_tum(tmp_path), None, options)
    np.testing.assert_allclose(scan.depth_m(scan.frames[0])[10:-10, 10:-10], 1.25, rtol=1e-5)


def test_depth_must_be_16_bit(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    cv2.imwrite(str(folder / "depth/0.100000.png"), np.full((HEIGHT, WIDTH), 200, np.uint8))
    with pytest.raises(InvalidScanError, match=r"0\.100000\.png must be a PNG with one channel of 16 bits"):
        open_scan(folder)


def test_files_that_change_after_opening(tmp_path: Path) -> None:
    scan = open_scan(write_tum(tmp_path))
    scan.frames[0].depth.write_bytes(b"\x89PNG\r\n\x1a\n rest is gone")
    with pytest.raises(InvalidScanError, match="can't be a depth image"):
        scan.depth_m(scan.frames[0])
    write_depth(scan.frames[1].depth, 5000, 32, 24)
    with pytest.raises(InvalidScanError, match="32 x 24 pixels where 64 x 48 are expected"):
        scan.depth_m(scan.frames[1])
    scan.frames[2].color.unlink()
    with pytest.raises(InvalidScanError, match=r"0\.200000\.png of frame rgb/0\.200000\.png can't be read"):
        scan.color_bytes(scan.frames[2])


def test_an_unreadable_image_is_discarded_and_counted(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    (folder / "rgb/0.000000.png").write_bytes(b"not an image")
    for damaged in (b"", b"not an image"):
        (folder / "depth/0.100000.png").write_bytes(damaged)
        scan = open_scan(folder)
        assert scan.discarded == {"unreadable_file": ("rgb/0.000000.png", "rgb/0.100000.png")}
    (folder / "rgb/0.200000.png").unlink()
    with pytest.raises(
        InvalidScanError, match="No frame of the scan can be used: 1 missing_file, 2 unreadable"
    ):
        open_scan(folder)


def test_an_image_that_its_exif_data_turns_is_refused(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (WIDTH, HEIGHT)).save(folder / "rgb/0.000000.png", format="JPEG", exif=exif)
    with pytest.raises(InvalidScanError, match="EXIF rotation"):
        open_scan(folder)


def test_an_image_of_gigapixels_is_refused_by_its_header(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    path = folder / "depth/0.000000.png"
    data = bytearray(path.read_bytes())
    data[16:24] = (40_000).to_bytes(4, "big") * 2
    path.write_bytes(bytes(data))
    with pytest.raises(InvalidScanError, match="40000 x 40000 pixels; the limit is 50 megapixels"):
        open_scan(folder)
