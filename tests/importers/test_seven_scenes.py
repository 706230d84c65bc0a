"""The 7-Scenes layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.importers.seven_scenes import DEFAULT_CAMERA
from tests.importers.scans import INTRINSICS, write_color, write_depth, write_seven_scenes


def seven_scenes(folder: Path, **options: object) -> Scan:
    return open_scan(folder, "7scenes", ScanOptions(camera=CameraHint(values=INTRINSICS), **options))  # type: ignore[arg-type]


def test_one_folder(tmp_path: Path) -> None:
    scan = seven_scenes(write_seven_scenes(tmp_path, [0, 2, 30]))
    assert [frame.name for frame in scan.frames] == [f"frame-{n:06d}.color.png" for n in (0, 2, 30)]
    assert [frame.timestamp_s for frame in scan.frames] == pytest.approx([0, 2 / 30, 1.0])
    assert [frame.scan_from_camera.translation[0] for frame in scan.frames] == [0, 0.02, 0.3]
    np.testing.assert_array_equal(scan.depth_m(scan.frames[0]), np.float32(1.0))


def test_rounded_rotations_become_rotations(tmp_path: Path) -> None:
    rotation = seven_scenes(write_seven_scenes(tmp_path)).frames[0].scan_from_camera.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[0, :2], [np.sqrt(0.75), -0.5], atol=1e-4)


def test_sequences_follow_one_another(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path / "seq-02", [0, 1])
    write_seven_scenes(tmp_path / "seq-01", [0, 5])
    write_seven_scenes(tmp_path / "unrelated", [0])
    scan = seven_scenes(tmp_path)
    assert [frame.name.split(".")[0] for frame in scan.frames] == [
        "seq-01/frame-000000",
        "seq-01/frame-000005",
        "seq-02/frame-000000",
        "seq-02/frame-000001",
    ]
    assert (np.diff([frame.timestamp_s for frame in scan.frames]) > 0).all()


def test_default_intrinsics(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, [0])
    write_color(tmp_path / "frame-000000.color.png", 640, 480)
    write_depth(tmp_path / "frame-000000.depth.png", 1000, 640, 480)
    scan = open_scan(tmp_path)
    assert scan.camera.params == DEFAULT_CAMERA.values == (525, 525, 320, 240)
    assert scan.depth.camera is not None
    assert scan.depth.camera.params == (585, 585, 320, 240)
    assert scan.depth.scale == 1000
    (tmp_path / "camera.txt").write_text("PINHOLE 640 480 525 525 320 240")
    described = open_scan(tmp_path)
    assert described.camera.params[0] == 525
    assert described.depth.camera is None


def test_poses_are_moved_from_the_depth_camera_to_the_colour_camera(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, [0])
    np.savetxt(tmp_path / "frame-000000.pose.txt", np.eye(4))
    color_from_depth = Pose(np.eye(3), np.array([-0.025, 0.0, 0.0]))
    scan = seven_scenes(
        tmp_path, depth_camera=CameraHint(values=INTRINSICS), color_from_depth=color_from_depth
    )
    np.testing.assert_allclose(scan.frames[0].scan_from_camera.translation, [0.025, 0, 0])


def test_what_is_missing_or_broken_is_discarded(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, list(range(10)))
    (tmp_path / "frame-000001.depth.png").unlink()
    (tmp_path / "frame-000002.pose.txt").unlink()
    np.savetxt(tmp_path / "frame-000003.pose.txt", np.full((4, 4), np.nan))
    (tmp_path / "frame-000004.pose.txt").write_text("-1.#IND " * 16)
    (tmp_path / "frame-000005.pose.txt").write_text("1 0 0 0")
    scan = seven_scenes(tmp_path)
    numbers = {r: [int(n[6:12]) for n in names] for r, names in scan.discarded.items()}
    assert numbers == {"no_depth": [1], "no_pose": [2], "invalid_pose": [3, 4, 5]}
    assert len(scan.frames) == 5


def test_mostly_broken_poses_are_no_scan(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, [0, 1])
    np.savetxt(tmp_path / "frame-000001.pose.txt", 3 * np.eye(4))
    with pytest.raises(InvalidScanError, match=r"1 of 2 poses .* frame-000001\.color\.png among them"):
        seven_scenes(tmp_path)


def test_a_folder_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "frame-1.png").write_bytes(b"")
    with pytest.raises(InvalidScanError, match=r"no frame-000000\.color\.png"):
        seven_scenes(tmp_path)


def test_links_that_leave_the_folder_are_refused(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan")
    pose = folder / "frame-000001.pose.txt"
    pose.rename(tmp_path / "pose.txt")
    pose.symlink_to(tmp_path / "pose.txt")
    with pytest.raises(InvalidScanError, match="leaves the scan's folder"):
        seven_scenes(folder)
