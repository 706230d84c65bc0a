"""Formats by the names of files alone, complete and with something missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.errors import InvalidScanError
from app.importers.frames import ScanOptions
from app.importers.recognition import PARTS, recognised
from app.importers.registry import FORMATS, open_scan


def test_every_format_is_known_by_names() -> None:
    assert set(PARTS) == set(FORMATS)


@pytest.mark.parametrize(
    ("names", "expected", "folder", "missing"),
    [
        (["a/rgb.txt", "a/groundtruth.txt", "a/rgb/0.png"], "tum", "a", ()),
        (["x/8653/odometry.csv", "x/8653/camera_matrix.csv"], "stray-scanner", "x/8653", ("rgb.mp4",)),
        (["metadata", "rgbd/0.jpg", "rgbd/0.depth"], "record3d", "", ()),
        (["walk.r3d"], "record3d", "", ()),
        (["s/seq-01/frame-000000.color.png", "s/seq-01/frame-000000.depth.png"], "7scenes", "s/seq-01",
         ("frame-000000.pose.txt",)),
        (["bag/metadata.yaml", "bag/bag_0.mcap"], "ros-bag", "bag", ()),
        (["keyframes/cameras/1.json", "keyframes/images/1.jpg"], "polycam", "", ()),
        (["keyframes/cameras/1.json", "keyframes/depth/1.png"], "polycam", "", ("keyframes/images",)),
        (["a/frame-000000.color.png", "a/frame-000000.pose.txt"], "7scenes", "a", ()),
        (["color/0.jpg", "pose/0.txt", "intrinsic/intrinsic_color.txt"], "scannet", "", ()),
        (["color/0.jpg", "trajectory.log"], "redwood", "", ()),
        (["rgbd/0.jpg", "metadata"], "record3d", "", ()),
    ],
)  # fmt: skip
def test_names_say_the_format_and_what_is_missing(
    names: list[str], expected: str, folder: str, missing: tuple[str, ...]
) -> None:
    (found,) = recognised(names)
    assert (found.format, found.folder, found.missing) == (expected, folder, missing)


def test_other_names_are_nothing() -> None:
    assert recognised(["holiday/1.jpg", "notes.txt"]) == ()
    assert recognised([]) == ()


def test_a_usdz_is_named_with_what_to_export_instead(tmp_path: Path) -> None:
    # What a USDZ holds: it is a zip.
    (tmp_path / "0").mkdir()
    for name in ("room.usdc", "0/texture.png"):
        (tmp_path / name).write_bytes(b"PXR-USDC")
    with pytest.raises(InvalidScanError, match=r"This is a USDZ.*raw data"):
        open_scan(tmp_path, "auto", ScanOptions())
