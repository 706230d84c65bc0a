"""Databases and bags in the versions that recorders write: the same frames become the same scan."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from app.errors import InvalidScanError
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from app.importers.unpack_scan import unpack_scan
from bench.formats import recordings
from bench.formats.frames import WrittenFrame, WrittenScan
from bench.tests.formats.scans import CAMERA, FRAMES, HEIGHT, WIDTH, tiny_scan
from bench.tests.formats.test_formats import assert_is
from tests.importers.test_rvl import encode_rvl


def rvl_of(frame: WrittenFrame) -> bytes:
    """Return the size and the values of a frame's depth, as RVL stands in databases and messages."""
    height, width = frame.depth_mm.shape
    return struct.pack("<2I", width, height) + encode_rvl(frame.depth_mm)


def test_depth_of_rtabmap_as_rvl(tmp_path: Path) -> None:
    expected = tiny_scan()
    path = recordings.rtabmap(expected, tmp_path / "scan")
    with closing(sqlite3.connect(path)) as connection, connection:
        for number, frame in enumerate(expected.frames, start=1):
            depth = b"DEPTHRVL" + rvl_of(frame)
            connection.execute("UPDATE Data SET depth = ? WHERE id = ?", (depth, number))
    scan = open_scan(unpack_scan(path, tmp_path / "unpacked"))
    assert_is(scan, expected)
    np.testing.assert_allclose(scan.depth_m(scan.frames[1]), expected.frames[1].depth_m, atol=1e-3)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE Data SET depth = ?", (b"DEPTHRVL" + rvl_of(expected.frames[0])[:500],))
    with pytest.raises(InvalidScanError, match="it is no RVL image"):
        open_scan(unpack_scan(path, tmp_path / "damaged"))


# The range of 32FC1 in compressedDepth: depth is A / (value - B) metres, so 1 m is 49,995.
A = 5e4
B = -5.0


def _packed(encoding: str, data: bytes, values: tuple[float, float] = (0.0, 0.0)) -> tuple[str, bytes]:
    return encoding, struct.pack("<i2f", 0, *values) + data


def inverse_depth(frame: WrittenFrame) -> tuple[str, bytes]:
    raw = (A / frame.depth_m + B).round().astype(np.uint16)
    return _packed("32FC1; compressedDepth png", cv2.imencode(".png", raw)[1].tobytes(), (A, B))


BAGS: dict[str, recordings.BagKind] = {
    "floats": recordings.BagKind(depth=lambda f: ("32FC1", f.depth_m.astype("<f4").tobytes())),
    "compressed": recordings.BagKind(
        compressed_color=True,
        compressed_depth=True,
        depth=lambda f: _packed("16UC1; compressedDepth", f.depth_png),
    ),
    "RVL": recordings.BagKind(
        compressed_depth=True, depth=lambda f: _packed("16UC1; compressedDepth rvl", rvl_of(f))
    ),
    "plain PNG": recordings.BagKind(
        compressed_depth=True, depth=lambda f: ("16UC1; png compressed", f.depth_png)
    ),
    "compressed floats": recordings.BagKind(compressed_depth=True, depth=inverse_depth),
    "transforms": recordings.BagKind(poses_as_transforms=True),
}


@pytest.mark.parametrize("version", ["1", "2"])
@pytest.mark.parametrize("name", BAGS)
def test_bags_as_recorders_write_them(tmp_path: Path, name: str, version: str) -> None:
    expected = tiny_scan()
    if version == "1":
        folder = unpack_scan(recordings.ros1(expected, tmp_path / "scan", BAGS[name]), tmp_path / "unpacked")
    else:
        folder = recordings.ros2(StoragePlugin.MCAP, expected, tmp_path / "scan", BAGS[name])
    scan = open_scan(folder)
    assert_is(scan, expected)
    np.testing.assert_allclose(scan.depth_m(scan.frames[3]), expected.frames[3].depth_m, atol=1e-3)


@pytest.mark.parametrize(
    ("model", "lens", "expected"),
    [
        ("rational_polynomial", (0.1, -0.05, 0.001, 0.002, 0.01, 0.2, 0.03, 0.004), "FULL_OPENCV"),
        ("equidistant", (0.1, -0.05, 0.01, 0.002), "OPENCV_FISHEYE"),
        ("plumb_bob", (0.1, -0.05, 0.001, 0.002, 0.0), "FULL_OPENCV"),
    ],
)
def test_lenses_of_bags(tmp_path: Path, model: str, lens: tuple[float, ...], expected: str) -> None:
    kind = recordings.BagKind(lens=lens, lens_model=model)
    path = recordings.ros1(tiny_scan(), tmp_path / "scan", kind)
    camera = open_scan(unpack_scan(path, tmp_path / "unpacked")).camera
    assert (camera.model, camera.params[4 : 4 + len(lens)]) == (expected, lens)


def test_a_lens_that_no_camera_has_and_a_bag_without_a_camera(tmp_path: Path) -> None:
    strange = recordings.BagKind(lens=(0.1,) * 14, lens_model="rational_polynomial")
    path = recordings.ros1(tiny_scan(), tmp_path / "strange", strange)
    with pytest.raises(InvalidScanError, match=r"rational_polynomial with 14 numbers.*give `camera`"):
        open_scan(unpack_scan(path, tmp_path / "1"))
    path = recordings.ros1(tiny_scan(), tmp_path / "none", recordings.BagKind(states_camera=False))
    with pytest.raises(InvalidScanError, match=r"no CameraInfo for /camera/color/image_raw: give `camera`"):
        open_scan(unpack_scan(path, tmp_path / "2"))


def test_a_split_bag_is_one_recording_and_two_bags_are_not(tmp_path: Path) -> None:
    scan = tiny_scan()
    halves = WrittenScan(CAMERA, scan.frames[:3], scan.down), WrittenScan(CAMERA, scan.frames[3:], scan.down)
    for number, half in enumerate(halves):
        recordings.ros1(half, tmp_path / f"split/walk_{number}")
        folder = recordings.ros2(StoragePlugin.MCAP, half, tmp_path / f"half{number}/walk")
        (tmp_path / "mcap").mkdir(exist_ok=True)
        (folder / "walk.mcap").rename(tmp_path / f"mcap/walk_{number}.mcap")
        recordings.ros1(half, tmp_path / f"two/walk{number}")
    assert_is(open_scan(tmp_path / "split"), scan)
    assert_is(open_scan(tmp_path / "mcap"), scan)
    with pytest.raises(
        InvalidScanError, match=r"2 bags, walk0\.bag, walk1\.bag: send those of one recording"
    ):
        open_scan(tmp_path / "two")


def test_a_bag_whose_poses_are_to_be_estimated_needs_none(tmp_path: Path) -> None:
    folder = recordings.ros2(
        StoragePlugin.MCAP, tiny_scan(), tmp_path / "scan", recordings.BagKind(has_poses=False)
    )
    with pytest.raises(InvalidScanError, match="The bag has no poses"):
        open_scan(folder)
    assert len(open_scan(folder, None, ScanOptions(estimate_poses=True)).frames) == FRAMES


def test_a_recording_of_the_realsense_viewer_is_named(tmp_path: Path) -> None:
    kind = recordings.BagKind(prefix="/device_0/sensor_1/Color_0")
    path = recordings.ros1(tiny_scan(), tmp_path / "scan", kind)
    with pytest.raises(InvalidScanError, match=r"recording of the RealSense Viewer.*align_depth"):
        open_scan(unpack_scan(path, tmp_path / "unpacked"))


def test_depth_of_another_frame_without_a_camera_is_not_taken_for_aligned(tmp_path: Path) -> None:
    kind = recordings.BagKind(depth_frame="camera_depth_optical_frame", depth_name="depth")
    path = recordings.ros1(tiny_scan(), tmp_path / "scan", kind)
    with pytest.raises(
        InvalidScanError, match=r"no CameraInfo for /camera/depth/image_raw: record its camera_info"
    ):
        open_scan(unpack_scan(path, tmp_path / "unpacked"))


def test_of_maps_of_rtabmap_that_nothing_joins_the_largest_is_read(tmp_path: Path) -> None:
    path = recordings.rtabmap(tiny_scan(), tmp_path / "scan")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE Node SET map_id = 1 WHERE id > 2")
    joined = open_scan(unpack_scan(path, tmp_path / "joined"))
    assert_is(joined, tiny_scan())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE Admin SET opt_ids = NULL, opt_poses = NULL")
    scan = open_scan(unpack_scan(path, tmp_path / "apart"))
    assert [frame.name[-6:] for frame in scan.frames] == ["000003", "000004", "000005"]
    assert len(scan.discarded["no_pose"]) == 2
    assert any("Of its 2 maps" in note for note in scan.notes)


@pytest.mark.parametrize("size", [(), (WIDTH, HEIGHT)])
def test_calibrations_of_older_versions_of_rtabmap(tmp_path: Path, size: tuple[int, ...]) -> None:
    expected = tiny_scan()
    path = recordings.rtabmap(expected, tmp_path / "scan")
    place = recordings.BASE_FROM_CAMERA.matrix[:3].ravel()
    values = np.array([*CAMERA.params[:4], *size, *place], "<f4").tobytes()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE Data SET calibration = ?", (values,))
    assert_is(open_scan(unpack_scan(path, tmp_path / "unpacked")), expected)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE Data SET calibration = ?", (bytes(len(values)),))
    with pytest.raises(InvalidScanError, match="no calibration that can be read"):
        open_scan(unpack_scan(path, tmp_path / "damaged"))


def test_a_database_of_an_old_version_of_rtabmap_says_what_to_do(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "map.db")) as connection, connection:
        connection.execute("CREATE TABLE Node (id INTEGER, stamp FLOAT, pose BLOB)")
        connection.execute("CREATE TABLE Data (id INTEGER, image BLOB)")
    with pytest.raises(
        InvalidScanError, match=r"older than those that are read .*newer RTAB-Map and save it, or"
    ):
        open_scan(tmp_path)


@pytest.mark.parametrize(
    "text", ["", "<html>", "rosbag2_bagfile_information:\n  version: NaN\n", "a:\n b\n c: d:"]
)
def test_damaged_metadata_of_a_bag_is_named_in_one_line(tmp_path: Path, text: str) -> None:
    folder = recordings.ros2_mcap(tiny_scan(), tmp_path / "scan")
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(InvalidScanError, match=r"scan\.mcap with its metadata\.yaml can't be read") as raised:
        open_scan(folder)
    assert str(tmp_path) not in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("offset", [12, 16])
def test_lengths_of_a_damaged_bag_are_no_exception_of_memory(tmp_path: Path, offset: int) -> None:
    folder = recordings.ros2_mcap(tiny_scan(), tmp_path / "scan")
    data = bytearray((folder / "scan.mcap").read_bytes())
    data[offset : offset + 4] = b"\xff" * 4
    (folder / "scan.mcap").write_bytes(data)
    with pytest.raises(InvalidScanError, match=r"scan\.mcap .*can't be read as a ROS bag"):
        open_scan(folder)
