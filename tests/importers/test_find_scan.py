"""The scan in what was sent: beside other files, below other folders, one of several, or none that is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers.frames import ScanOptions
from app.importers.registry import FORMATS, open_scan
from tests.importers.scans import INTRINSICS, write_seven_scenes, write_tum


def test_a_scan_beside_a_readme_and_a_preview(tmp_path: Path) -> None:
    write_tum(tmp_path / "my scan")
    (tmp_path / "README.txt").write_text("Scanned on Monday.")
    (tmp_path / "preview.jpg").write_bytes(b"x")
    (tmp_path / "meshes/textures").mkdir(parents=True)
    scan = open_scan(tmp_path)
    assert [frame.name for frame in scan.frames] == [f"rgb/0.{i}00000.png" for i in range(3)]


def test_a_scan_far_below(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path / "data/2024/redkitchen/seq-01")
    write_seven_scenes(tmp_path / "data/2024/redkitchen/seq-02")
    (tmp_path / "data/notes.txt").write_text("x")
    assert len(open_scan(tmp_path, None, ScanOptions(camera=CameraHint(values=INTRINSICS))).frames) == 6


def test_two_scans_are_named(tmp_path: Path) -> None:
    write_tum(tmp_path / "monday")
    write_seven_scenes(tmp_path / "more/tuesday/seq-01")
    with pytest.raises(
        InvalidScanError, match=r"holds 2 scans: monday \(tum\), more/tuesday \(7scenes\)\. Send each"
    ):
        open_scan(tmp_path)
    # A format that is asked for decides.
    assert len(open_scan(tmp_path, "tum").frames) == 3
    for i in range(9):
        write_tum(tmp_path / f"w{i}")
    with pytest.raises(InvalidScanError, match=r"holds 11 scans: .* and 5 more"):
        open_scan(tmp_path)


def test_links_to_other_folders_are_not_searched(tmp_path: Path) -> None:
    write_tum(tmp_path / "elsewhere")
    (tmp_path / "sent").mkdir()
    (tmp_path / "sent/scan").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InvalidScanError, match="can't be told from its files"):
        open_scan(tmp_path / "sent")


def test_every_format_is_named_once_where_none_is_found(tmp_path: Path) -> None:
    with pytest.raises(InvalidScanError) as error:
        open_scan(tmp_path)
    listed = str(error.value).partition("that are read are ")[2].partition(". At the top")[0].split(", ")
    assert sorted([*listed, "tum", "7scenes"]) == sorted(FORMATS)


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ("a1/rgb.mp4", "a1/odometry.csv", "a1/camera_matrix.csv", "a1/depth/0.png"),
            "rgb.mp4 is not a video",
        ),
        (("scene.sens", "scene.txt"), "scene.sens is cut short"),
        (("lowres_wide/0.png", "lowres_depth/0.png"), "lowres_wide.traj is missing"),
        (("x.r3d",), "x.r3d.*archive"),
        (("mav0/cam0/data.csv",), "EuRoC"),
        (("images.txt", "cameras.txt", "points3D.txt"), "The COLMAP model lists no pictures"),
        (("walk.bag",), "walk.bag can't be read as a ROS bag"),
        (("walk.mp4", "notes.md"), "This is a video among other files"),
        (("walk.mp4",), "walk.mp4 is not a video that can be decoded"),
        (("map.db",), "RTAB-Map"),
        (("notes.txt", "b.jpg"), r"can't be told .* At the top are: b\.jpg, notes\.txt\."),
        ((), "At the top are: no files"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, names: tuple[str, ...], message: str) -> None:
    touch(tmp_path, *names)
    with pytest.raises(InvalidScanError, match=message) as error:
        open_scan(tmp_path)
    assert len(str(error.value)) < 500


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tum", "rgb.txt is missing"),
        ("7scenes", "no frame-000000.color.png"),
        ("nerfstudio", "no transforms.json"),
        ("polycam", "keyframes/cameras with its .json files is missing"),
        ("scannet", "no color/0.jpg"),
        ("redwood", "no .log file"),
    ],
)
def test_a_format_that_was_asked_for_says_what_it_misses(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InvalidScanError, match=message):
        open_scan(tmp_path, name)
