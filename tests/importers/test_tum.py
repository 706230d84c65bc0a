"""The TUM layout: lists, association, poses, camera and gravity files, and every complaint about them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from tests.importers.scans import (
    INTRINSICS,
    real_scan,
    write_color,
    write_depth,
    write_tum,
)


def tum(folder: Path, **options: object) -> Scan:
    return open_scan(folder, "tum", ScanOptions(**options))  # type: ignore[arg-type]


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_plain_scan(tmp_path: Path) -> None:
    scan = tum(write_tum(tmp_path, [0.2, 0.0, 0.1]))
    assert [frame.name for frame in scan.frames] == [f"rgb/0.{i}00000.png" for i in range(3)]
    assert [frame.timestamp_s for frame in scan.frames] == [0.0, 0.1, 0.2]
    assert [frame.scan_from_camera.translation[0] for frame in scan.frames] == [1, 2, 0]
    assert scan.discarded == {}
    assert scan.gravity is None
    assert scan.depth.scale == 5000


def test_commas_tabs_windows_lines_and_byte_order_marks(tmp_path: Path) -> None:
    write_tum(tmp_path)
    rgb, depth, truth = (tmp_path / f"{n}.txt" for n in ("rgb", "depth", "groundtruth"))
    rgb.write_bytes(b"\xef\xbb\xbf" + rgb.read_bytes().replace(b" rgb/", b", rgb\\").replace(b"\n", b"\r\n"))
    depth.write_bytes(depth.read_text().replace(" depth/", "\t./depth/").encode("utf-16"))
    truth.write_text("\n\n  # remark\n" + truth.read_text().replace(" ", ",") + "\n\n")
    assert len(tum(tmp_path).frames) == 3


def test_names_may_hold_blanks(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "rgb").rename(tmp_path / "my images")
    replace(tmp_path / "rgb.txt", " rgb/", " my images/")
    assert tum(tmp_path).frames[0].name == "my images/0.000000.png"


def test_what_has_no_partner_is_discarded_with_its_reason(tmp_path: Path) -> None:
    times = [i / 10 for i in range(8)]
    write_tum(tmp_path, times)
    replace(tmp_path / "depth.txt", "0.100000 depth", "0.130000 depth")
    replace(tmp_path / "groundtruth.txt", "0.200000 2 0 0", "0.230000 2 0 0")
    replace(tmp_path / "groundtruth.txt", "0.300000 3 0 0", "0.300000 nan 0 0")
    replace(tmp_path / "groundtruth.txt", "0.400000 4 0 0 0 0 0 1", "0.400000 4 0 0 0 0 0 0")
    (tmp_path / "rgb/0.500000.png").unlink()
    (tmp_path / "depth/0.600000.png").unlink()
    scan = tum(tmp_path)
    assert [frame.name for frame in scan.frames] == ["rgb/0.000000.png", "rgb/0.700000.png"]
    assert scan.discarded == {
        "missing_file": ("rgb/0.500000.png", "rgb/0.600000.png"),
        "no_depth": ("rgb/0.100000.png",),
        "no_pose": ("rgb/0.200000.png",),
        "invalid_pose": ("rgb/0.300000.png", "rgb/0.400000.png"),
    }


def test_a_missing_image_takes_no_depth_from_another(tmp_path: Path) -> None:
    write_tum(tmp_path, [0.0])
    with (tmp_path / "rgb.txt").open("a") as lines:
        lines.write("0.001 rgb/gone.png\n")
    replace(tmp_path / "depth.txt", "0.000000 depth", "0.001000 depth")
    assert len(tum(tmp_path).frames) == 1


def test_the_tolerance_is_an_option(tmp_path: Path) -> None:
    write_tum(tmp_path)
    replace(tmp_path / "depth.txt", "0.100000 depth", "0.130000 depth")
    assert len(tum(tmp_path, max_time_difference_s=0.031).frames) == 3


def test_no_usable_frame_counts_the_reasons(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "depth.txt").write_text("\n".join(f"{t} depth/0.000000.png" for t in (5, 6, 7)))
    with pytest.raises(InvalidScanError, match="No frame of the scan can be used: 3 no_depth"):
        tum(tmp_path)


def test_mostly_broken_poses_are_no_scan(tmp_path: Path) -> None:
    write_tum(tmp_path, [0.0, 0.1, 0.2, 0.3])
    for i in (1, 2):
        replace(tmp_path / "groundtruth.txt", f"0.{i}00000 {i} 0 0", f"0.{i}00000 {i} inf 0")
    with pytest.raises(InvalidScanError, match=r"2 of 4 poses .* the one at 0\.100000 s among them"):
        tum(tmp_path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("depth.txt", "no depth images"),
        ("groundtruth.txt", "no camera poses"),
        ("rgb.txt", "no colour images"),
    ],
)
def test_missing_and_empty_lists(tmp_path: Path, name: str, message: str) -> None:
    write_tum(tmp_path)
    (tmp_path / name).write_text("# nothing here\n")
    with pytest.raises(InvalidScanError, match=message):
        tum(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(InvalidScanError, match=f"{message}: {name} is missing"):
        tum(tmp_path)


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("rgb.txt", "0.5", "rgb.txt line 5: expected a timestamp and a file name"),
        ("rgb.txt", "noon rgb/a.png", "rgb.txt line 5: 'noon' must be numbers"),
        ("depth.txt", "nan depth/a.png", "depth.txt line 5: the timestamp 'nan'"),
        ("groundtruth.txt", "0.5 1 2 3", "groundtruth.txt line 5: expected 8 columns"),
        (
            "groundtruth.txt",
            "0.5 1 2 3 a b c d",
            "groundtruth.txt line 5: '0.5 1 2 3 a b c d' must be numbers",
        ),
        ("groundtruth.txt", "inf 1 2 3 0 0 0 1", "groundtruth.txt line 5: the timestamp 'inf'"),
        ("rgb.txt", "0.5 ../secret.png", "must lie inside"),
        ("rgb.txt", "0.5 rgb/../../secret.png", "must lie inside"),
        ("rgb.txt", "0.5 rgb\\..\\..\\secret.png", "must lie inside"),
        ("rgb.txt", "0.5 /etc/passwd", "must lie inside"),
        ("depth.txt", "0.5 C:\\depth.png", "must lie inside"),
        ("depth.txt", "0.5 depth/a\x00.png", "not a file name"),
        ("depth.txt", "0.5 " + "a" * 2000, "not a file name"),
    ],
)
def test_malformed_lines_are_named(tmp_path: Path, name: str, line: str, message: str) -> None:
    write_tum(tmp_path)
    with (tmp_path / name).open("a") as lines:
        lines.write(line + "\n")
    with pytest.raises(InvalidScanError) as error:
        tum(tmp_path)
    assert message in str(error.value)


@pytest.mark.parametrize("link", ["rgb/0.100000.png", "rgb", "groundtruth.txt"])
def test_links_that_leave_the_folder_are_refused(tmp_path: Path, link: str) -> None:
    folder = write_tum(tmp_path / "scan")
    (folder / link).rename(tmp_path / "elsewhere")
    (folder / link).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InvalidScanError, match="leaves the scan's folder"):
        tum(folder)


def test_links_within_the_folder_are_followed(tmp_path: Path) -> None:
    folder = write_tum(tmp_path)
    (folder / "rgb").rename(folder / "color")
    (folder / "rgb").symlink_to("color")
    assert len(tum(folder).frames) == 3


def test_camera_file(tmp_path: Path) -> None:
    write_tum(tmp_path, camera="# depth_scale = 1000 per metre\nPINHOLE 64 48 61 62 30 20")
    scan = tum(tmp_path)
    assert scan.camera.params == (61, 62, 30, 20)
    assert scan.depth.scale == 1000
    assert tum(tmp_path, camera=CameraHint(values=INTRINSICS)).camera.params == INTRINSICS
    assert tum(tmp_path, camera=CameraHint(values=INTRINSICS)).depth.scale == 1000
    assert tum(tmp_path, depth_scale=2000.0).depth.scale == 2000
    (tmp_path / "camera.txt").write_text("60,60,31.5,23.5,0.1,0,0,0\n")
    assert tum(tmp_path).camera.model == "OPENCV"


@pytest.mark.parametrize(
    ("text", "params"),
    [
        ("60 0 31.5\n0 61 23.5\n0 0 1\n", (60, 61, 31.5, 23.5)),
        ("# K\n60, 0, 31.5, 0\n0, 61, 23.5, 0\n0, 0, 1, 0\n0, 0, 0, 1\n", (60, 61, 31.5, 23.5)),
        ("SIMPLE_PINHOLE 64 48 60 31.5 23.5", (60, 60, 31.5, 23.5)),
    ],
)
def test_a_camera_file_as_other_tools_write_it(tmp_path: Path, text: str, params: tuple[float, ...]) -> None:
    write_tum(tmp_path, camera=text)
    assert tum(tmp_path).camera.params == params


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "one row"),
        ("60 0 31.5\n0 61 23.5\n0 0 2\n", "as a 3x3 matrix must be"),
        ("60 0 31.5\n0 61\n0 0 1\n", "one row"),
        ("60 0 31.5\nzero 61 23.5\n0 0 1\n", "must be numbers"),
        ("PINHOLE 64 48 60 60 31 23\nPINHOLE 64 48 60 60 31 23", "one row"),
        ("RADTAN 64 48 60 60 31 23", "model 'RADTAN' is not known"),
        ("PINHOLE 64 48 60", "PINHOLE takes 4 parameters"),
        ("PINHOLE 64.5 48 60 60 31 23", "whole pixels"),
        ("PINHOLE 64 nan 60 60 31 23", "whole pixels"),
        ("PINHOLE sixty 48 60 60 31 23", "must be numbers"),
        ("PINHOLE 64 48 1e9 60 31 23", "fx = 1e\\+09 px"),
        ("60 60 31", "4, 8 or 9 numbers"),
        ("# depth_scale = 0\n60 60 31 23", "depth_scale must be above 0"),
    ],
)
def test_bad_camera_files(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidScanError, match=message):
        tum(write_tum(tmp_path, camera=text))


@pytest.mark.parametrize(
    ("sensor", "fx", "distortion"), [(1, 517.3, 1.1633), (2, 520.9, 0.9172), (3, 535.4, None)]
)
def test_published_intrinsics_of_the_benchmark(
    tmp_path: Path, sensor: int, fx: float, distortion: float | None
) -> None:
    write_tum(tmp_path, [0.0], camera=None)
    write_color(tmp_path / "rgb/0.000000.png", 640, 480)
    write_depth(tmp_path / "depth/0.000000.png", 5000, 640, 480)
    truth = tmp_path / "groundtruth.txt"
    truth.write_text(f"# file: 'rgbd_dataset_freiburg{sensor}_desk.bag'\n" + truth.read_text())
    camera = tum(tmp_path).camera
    assert camera.params[0] == fx
    # FULL_OPENCV's order: fx fy cx cy k1 k2 p1 p2 k3.
    assert (camera.params[8] if distortion else None) == distortion
    assert camera.is_distorted == (distortion is not None)


def test_published_intrinsics_are_for_their_size_only(tmp_path: Path) -> None:
    write_tum(tmp_path, camera=None)
    truth = tmp_path / "groundtruth.txt"
    truth.write_text("# file: 'rgbd_dataset_freiburg1_desk.bag'\n" + truth.read_text())
    with pytest.raises(InvalidScanError, match="64 x 48 pixels, but the camera is for 640 x 480"):
        tum(tmp_path)


def test_an_unknown_camera_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError, match="camera is not known: give `camera` in the options"):
        tum(write_tum(tmp_path, camera=None))


def test_gravity_file(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "gravity.txt").write_text("# down\n0 3 4\n")
    assert tum(tmp_path).gravity == pytest.approx((0, 0.6, 0.8))
    for text in ("", "0 1", "0 0 0", "nan 0 1", "0 0 1\n0 0 1"):
        (tmp_path / "gravity.txt").write_text(text)
        with pytest.raises(InvalidScanError, match=r"gravity\.txt must hold one row of three numbers"):
            tum(tmp_path)


def test_poses_between_full_rate_rows(tmp_path: Path) -> None:
    write_tum(tmp_path, [1.0])
    rows = [f"{0.955 + 0.01 * i:.3f} {i} 0 0 0 0 0 1" for i in range(10)]
    (tmp_path / "groundtruth.txt").write_text("\n".join(rows))
    assert tum(tmp_path).frames[0].scan_from_camera.translation[0] == pytest.approx(4.5)


def test_the_real_rpy_sequence() -> None:
    scan = tum(real_scan("tum_fr1_rpy"))
    assert len(scan.frames) == 113
    assert {reason: len(names) for reason, names in scan.discarded.items()} == {"no_depth": 8}
    assert scan.camera.params[:4] == (517.3, 516.5, 318.6, 255.3)
    assert scan.depth.scale == 5000
    assert 0.5 < np.median(scan.depth_m(scan.frames[0])) < 3
    # Consecutive frames, 0.2 s apart, turn by what a hand does and hardly move.
    steps = np.diff([frame.scan_from_camera.translation for frame in scan.frames], axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 0.25


def test_the_real_kitchen_sequence() -> None:
    scan = tum(real_scan("redkitchen"))
    assert len(scan.frames) == 500
    assert scan.discarded == {}
    assert scan.depth.scale == 1000
    assert scan.gravity is not None
    # Synchronised stamps: the pose is that of the file.
    np.testing.assert_allclose(scan.frames[0].scan_from_camera.translation, [-0.468403, 0.0212513, 0.2941897])
