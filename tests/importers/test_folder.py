"""Files are found by the names that lists give them, however both were spelled; and what is there instead is said."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest

from app.errors import InvalidScanError
from app.importers.folder import ScanFolder
from app.importers.registry import open_scan
from tests.importers.scans import write_tum


def folder_with(path: Path, *names: str) -> ScanFolder:
    for name in names:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(b"x")
    return ScanFolder(path)


@pytest.mark.parametrize(
    ("there", "listed"),
    [
        ("rgb/00.JPG", "rgb/00.jpg"),
        ("RGB/00.jpg", "rgb\\00.jpg"),
        ("rgb/00.jpg", "./rgb//00.jpg"),
        (unicodedata.normalize("NFD", "küche/ö.png"), "küche/ö.png"),
        ("Küche/Ö.png", unicodedata.normalize("NFD", "küche/ö.PNG")),
        # A zip of Windows without Unicode, as readers show its names, and the list in UTF-8.
        ("图像".encode("gb18030").decode("cp437") + "/0.png", "图像/0.png"),
        ("カメラ".encode("shift_jis").decode("cp437") + "/0.png", "カメラ/0.png"),
        ("küche".encode("cp1252").decode("cp437") + "/0.png", "küche/0.png"),
        # A list in that page, which is read in code page 437, and the file in Unicode.
        ("küche/0.png", "küche".encode("cp1252").decode("cp437") + "/0.png"),
    ],
)
def test_one_file_under_two_spellings(tmp_path: Path, there: str, listed: str) -> None:
    folder = folder_with(tmp_path, there, "other/x.png")
    found = folder.find(listed, "rgb.txt line 1")
    assert found is not None
    assert folder.name_of(found) == there


def test_what_fits_several_is_none_of_them(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, "rgb/A.png", "rgb/a.PNG")
    assert folder.find("rgb/a.png", "here") is None
    assert folder.find("rgb/A.png", "here") == tmp_path / "rgb/A.png"
    assert folder.instead("rgb/a.png") == "the folder rgb has A.png and a.PNG, and which is meant isn't known"


@pytest.mark.parametrize(
    ("name", "instead"),
    [
        ("rgb/00.png", "the folder rgb has 00.jpg instead"),
        ("rgb/77.jpg", "the folder rgb holds 4 files, such as 00.jpg, 01.jpg, 02.jpg"),
        ("image/00.jpg", "the scan has no folder image; it has empty, rgb"),
        ("rgb/left/00.jpg", "rgb has no folder left; it has none"),
        ("empty/00.jpg", "the folder empty holds no files"),
        ("list.csv", "the scan's folder has list.txt instead"),
    ],
)
def test_what_is_there_instead(tmp_path: Path, name: str, instead: str) -> None:
    folder = folder_with(tmp_path, *(f"rgb/0{i}.jpg" for i in range(4)), "list.txt")
    (tmp_path / "empty").mkdir()
    assert folder.find(name, "here") is None
    assert folder.instead(name) == instead


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", "rgb/../../x", "C:\\x", ""])
def test_paths_that_leave_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidScanError, match="must lie inside"):
        ScanFolder(tmp_path).find(name, "here")


def test_a_link_under_another_spelling_is_not_followed_out(tmp_path: Path) -> None:
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret/0.png").write_bytes(b"x")
    scan = tmp_path / "scan"
    scan.mkdir()
    (scan / "RGB").symlink_to(tmp_path / "secret")
    with pytest.raises(InvalidScanError, match="leaves the scan's folder"):
        ScanFolder(scan).find("rgb/0.png", "here")


def test_the_first_missing_file_is_named_with_what_is_there(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "rgb/0.100000.png").rename(tmp_path / "rgb/0.100000.tif")
    scan = open_scan(tmp_path)
    assert scan.discarded == {"missing_file": ("rgb/0.100000.png",)}
    assert scan.notes == (
        "The first missing file: rgb/0.100000.png of rgb.txt line 3; the folder rgb has 0.100000.tif instead.",
    )
    (tmp_path / "depth").rename(tmp_path / "depths")
    with pytest.raises(
        InvalidScanError, match=r"3 missing_file\. The first missing file: rgb/0\.100000\.png of rgb"
    ):
        open_scan(tmp_path)
    (tmp_path / "rgb/0.100000.tif").rename(tmp_path / "rgb/0.100000.png")
    with pytest.raises(
        InvalidScanError,
        match=r"depth/0\.000000\.png of depth\.txt line 2; the scan has no folder depth; it has depths, rgb\.$",
    ):
        open_scan(tmp_path)


def test_lists_in_another_case_and_quoted_names(tmp_path: Path) -> None:
    write_tum(tmp_path)
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt", "camera.txt"):
        (tmp_path / name).rename(tmp_path / name.upper())
    text = (tmp_path / "RGB.TXT").read_text()
    (tmp_path / "RGB.TXT").write_text(text.replace(" rgb/", ' "rgb/').replace(".png", '.png"'))
    assert len(open_scan(tmp_path).frames) == 3


@pytest.mark.parametrize("name", ["associations.txt", "associate.txt", "Associations.txt"])
@pytest.mark.parametrize("depth_first", [False, True])
def test_associations_instead_of_two_lists(tmp_path: Path, name: str, depth_first: bool) -> None:
    write_tum(tmp_path)
    pairs = zip(
        (tmp_path / "rgb.txt").read_text().splitlines()[1:],
        (tmp_path / "depth.txt").read_text().splitlines()[1:],
        strict=True,
    )
    lines = [f"{depth} {color}" if depth_first else f"{color} {depth}" for color, depth in pairs]
    for listed in ("rgb.txt", "depth.txt"):
        (tmp_path / listed).unlink()
    (tmp_path / name).write_text("\n".join(lines))
    assert [frame.name for frame in open_scan(tmp_path).frames] == [f"rgb/0.{i}00000.png" for i in range(3)]
    (tmp_path / name).write_text("0.0 rgb/0.000000.png\n")
    with pytest.raises(InvalidScanError, match="must have rows `timestamp colour-file timestamp depth-file`"):
        open_scan(tmp_path)


@pytest.mark.parametrize("name", ["CameraTrajectory.txt", "poses.csv", "run.tum", "KeyFrameTrajectory.txt"])
def test_a_single_other_trajectory(tmp_path: Path, name: str) -> None:
    write_tum(tmp_path)
    (tmp_path / "groundtruth.txt").rename(tmp_path / name)
    (tmp_path / "accelerometer.txt").write_text("0.0 1 2 3\n0.1 1 2 3\n")
    (tmp_path / "README.txt").write_text("A scan of the lab.\n")
    scan = open_scan(tmp_path)
    assert [frame.scan_from_camera.translation[0] for frame in scan.frames] == [0, 1, 2]
    assert scan.notes == (
        f"The poses were read from {name}, the only trajectory, as there is no groundtruth.txt.",
    )
    (tmp_path / "another.txt").write_text((tmp_path / name).read_text())
    with pytest.raises(InvalidScanError) as error:
        open_scan(tmp_path)
    first, second = sorted([name, "another.txt"])
    assert f"groundtruth.txt is missing. {first} and {second} hold trajectories: send only the one" in str(
        error.value
    )
