"""Pictures of frames that a build left out: which are chosen, and which files are never read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.engine.mapping.structure.chosen import choose_pictures
from app.engine.progress import NoProgress
from app.geometry.camera_hint import hint_of
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.importers.unposed.scan import UnposedScan
from app.services.builds.left_out import OPTIONS, left_out_frames
from app.vision.images import decode_image
from tests import scenes


@pytest.fixture
def scan(tmp_path: Path, views: list[scenes.View]) -> Scan:
    """A scan in the folder `scan`, beside which a picture lies that is nobody's business."""
    for name, data in scenes.scan_files(views[:4]).items():
        path = tmp_path / "scan" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    (tmp_path / "secret.png").write_bytes(views[0].png())
    camera = hint_of(scenes.CAMERA)
    return open_scan(tmp_path / "scan", options=ScanOptions(camera=camera))


def names_of(scan: Scan, *names: str) -> list[str]:
    return [frame.name for frame in left_out_frames(scan, {"no_depth": names}, None)]


def test_a_file_below_the_scans_folder_is_shown(scan: Scan, tmp_path: Path, views: list[scenes.View]) -> None:
    (tmp_path / "scan" / "rgb" / "more.png").write_bytes(views[5].png())
    (found,) = left_out_frames(scan, {"no_pose": ["rgb/more.png"]}, None)
    assert (found.reason, found.name, found.time_s) == ("no_pose", "rgb/more.png", None)
    expected = cv2.resize(views[5].rgb, (240, 180), interpolation=cv2.INTER_AREA)
    assert np.abs(decode_image(found.jpeg).astype(int) - expected).mean() < 12


@pytest.mark.parametrize(
    "name", ["../secret.png", "rgb/../../secret.png", "/etc/passwd", "C:/secret.png", "rgb\\..\\..\\secret.png",
             "", ".", "rgb", "a\0b.png", "rgb/" + "x" * 5000 + ".png", "rgb/none.png", "\udc80.png"]
)  # fmt: skip
def test_a_name_that_leads_elsewhere_shows_nothing(scan: Scan, name: str) -> None:
    assert names_of(scan, name) == []


def test_an_absolute_path_or_a_link_out_of_the_folder_shows_nothing(scan: Scan, tmp_path: Path) -> None:
    (tmp_path / "scan" / "rgb" / "link.png").symlink_to(tmp_path / "secret.png")
    assert names_of(scan, str(tmp_path / "secret.png"), "rgb/link.png") == []


def test_files_that_are_no_pictures_or_too_large_are_passed_over(scan: Scan, tmp_path: Path) -> None:
    folder = tmp_path / "scan" / "rgb"
    (folder / "text.png").write_bytes(b"<html>")
    (folder / "empty.png").write_bytes(b"")
    huge = bytearray(scenes.encode(np.zeros((40, 40, 3), np.uint8), ".png"))
    huge[16:24] = (40_000).to_bytes(4, "big") * 2
    (folder / "huge.png").write_bytes(huge)
    (folder / "good.png").write_bytes(scenes.encode(np.full((40, 40, 3), 90, np.uint8), ".png"))
    assert names_of(scan, *(f"rgb/{name}.png" for name in ("text", "empty", "huge", "good"))) == [
        "rgb/good.png"
    ]


def test_as_many_as_are_kept_are_evenly_chosen_of_those_that_are_there(scan: Scan, tmp_path: Path) -> None:
    picture = scenes.encode(np.full((40, 40, 3), 90, np.uint8), ".png")
    for number in range(50):
        (tmp_path / "scan" / "rgb" / f"more-{number:02d}.png").write_bytes(picture)
    there = [f"rgb/more-{number:02d}.png" for number in range(50)]
    missing = [f"rgb/gone-{number:02d}.png" for number in range(500)]
    shown = names_of(scan, *missing, *there)
    assert len(shown) == OPTIONS.pictures
    assert shown == [f"rgb/more-{number:02d}.png" for number in (0, 10, 20, 29, 39, 49)]


def test_the_worst_picture_is_small(scan: Scan, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (240, 240, 3), np.uint8)
    (tmp_path / "scan" / "rgb" / "noise.png").write_bytes(scenes.encode(noise, ".png"))
    (found,) = left_out_frames(scan, {"no_depth": ["rgb/noise.png"]}, None)
    assert decode_image(found.jpeg).shape == (240, 240, 3)
    assert len(found.jpeg) < 45_000


def test_frames_without_a_file_of_their_name_bring_their_own(scan: Scan, tmp_path: Path) -> None:
    *kept, last = scan.frames
    lost = replace(last, name="walk.mp4/000003")
    video = replace(scan, frames=tuple(kept), left_out=(lost,))
    (found,) = left_out_frames(video, {"unconnected": [lost.name]}, None)
    assert (found.name, found.time_s) == ("walk.mp4/000003", 0.3)
    # Where times only give the order, none is told.
    (found,) = left_out_frames(replace(video, has_times=False), {"unconnected": [lost.name]}, None)
    assert found.time_s is None


def test_photos_that_are_not_used_are_shown(tmp_path: Path, views: list[scenes.View]) -> None:
    photos = {f"{row}.png": views[row].png() for row in range(4)}
    photos["black.png"] = scenes.encode(np.zeros((240, 320, 3), np.uint8), ".png")
    photos["broken.png"] = views[4].png()[:-5000]
    photos["small.png"] = scenes.encode(
        cv2.resize(views[5].rgb, (160, 120))[..., ::-1].astype(np.uint8), ".png"
    )
    for name, data in photos.items():
        (tmp_path / name).write_bytes(data)
    unposed = UnposedScan(format="images", photos=tuple(sorted(tmp_path.iterdir())), scratch=tmp_path)
    scan = choose_pictures(unposed, (), 3, NoProgress()).scan
    found = {frame.name: frame for frame in left_out_frames(scan, scan.discarded, None)}
    assert {name: frame.reason for name, frame in found.items()} == {
        "black.png": "poor_image",
        "small.png": "other_size",
    }
    # Photos have no times, only an order.
    assert {frame.time_s for frame in found.values()} == {None}
    assert scan.discarded["unreadable_file"] == ("broken.png",)
