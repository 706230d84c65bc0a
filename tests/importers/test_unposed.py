"""Pictures without poses: a lone video, photos, and scans whose poses are to be estimated."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZipFile

import cv2
import numpy as np
import pytest

from app.engine.mapping.structure.chosen import choose_pictures
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers.frames import ScanOptions
from app.importers.recognition import recognised
from app.importers.registry import open_scan, open_unposed
from app.importers.unposed.recording import RecordingWriter
from tests.importers.scans import INTRINSICS, write_color, write_seven_scenes, write_tum, write_video

ESTIMATE = ScanOptions(estimate_poses=True)


def test_a_lone_video_needs_no_option(tmp_path: Path) -> None:
    write_video(tmp_path / "walk.MP4")
    unposed = open_unposed(tmp_path, "auto", ScanOptions())
    assert unposed is not None
    assert (unposed.format, unposed.video) == ("video", tmp_path / "walk.MP4")
    with pytest.raises(
        InvalidScanError, match=r"walk\.MP4 is a video of 320 x 160 pixels, 1 s\. Camera poses are needed"
    ):
        open_scan(tmp_path)


def test_frames_of_a_video_are_chosen_and_wanted_times_with_them(tmp_path: Path) -> None:
    write_video(tmp_path / "walk.mp4")
    unposed = open_unposed(
        tmp_path,
        "video",
        ScanOptions(scratch=tmp_path, camera=CameraHint(values=(300.0, 300.0, 160.0, 80.0))),
    )
    assert unposed is not None
    chosen = choose_pictures(unposed, ["0.72"], 3, NoProgress())
    names = [frame.name for frame in chosen.scan.frames]
    assert "walk.mp4/000007" in names
    assert len(names) < chosen.total == 12
    assert (chosen.camera_source, chosen.original_size) == ("given", (320, 160))
    assert not chosen.scan.has_depth


def test_a_damaged_video_is_said_before_anything_is_built(tmp_path: Path) -> None:
    path = write_video(tmp_path / "walk.mp4")
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InvalidScanError, match=r"walk\.mp4 is not a video that can be decoded"):
        open_unposed(tmp_path, "auto", ScanOptions())


def test_a_video_of_a_camera_that_stood_still_is_too_little(tmp_path: Path) -> None:
    write_video(tmp_path / "still.mp4", step_px=0)
    unposed = open_unposed(tmp_path, "auto", ScanOptions(scratch=tmp_path))
    assert unposed is not None
    with pytest.raises(InvalidScanError, match="Of 12 pictures 1 differ enough"):
        choose_pictures(unposed, (), 8, NoProgress())


def test_photos_in_one_folder_need_no_option(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    for name in ("b.jpg", "a.JPG", "c.png"):
        (tmp_path / "hall" / name).write_bytes(b"x")
    unposed = open_unposed(tmp_path, None, ScanOptions())
    assert unposed is not None
    assert [path.name for path in unposed.photos] == ["a.JPG", "b.jpg", "c.png"]
    with pytest.raises(InvalidScanError, match="None of the 3 photos can be used: 3 unreadable_file"):
        choose_pictures(unposed, (), 8, NoProgress())


def test_photos_that_are_left_out_are_named_with_their_reason(tmp_path: Path) -> None:
    for number in range(4):
        write_color(tmp_path / f"{number}.png", 64 + 16 * (number == 3), 48)
    (tmp_path / "4.png").write_bytes(b"<html>")
    unposed = open_unposed(tmp_path, None, ScanOptions())
    assert unposed is not None
    with pytest.raises(InvalidScanError, match=r"Of 5 pictures 3 can be used") as raised:
        choose_pictures(unposed, (), 8, NoProgress())
    assert "1 damaged or no pictures at all, 4.png first, 1 of another size than most, 3.png first" in str(
        raised.value
    )


def test_two_photos_are_too_few(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.JPG"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InvalidScanError, match="A map of photos needs 3 or more of one place; there are 2"):
        open_scan(tmp_path)


@pytest.mark.parametrize(
    ("format_name", "files", "message"),
    [
        ("images", ("a.jpg", "notes.txt"), "photos, 3 or more; there are 1"),
        ("video", ("a.mp4", "b.mov"), "holds one video; there are 2"),
        ("video", ("a.jpg",), "there are 0: none"),
    ],
)
def test_what_is_missing_is_said(
    tmp_path: Path, format_name: str, files: tuple[str, ...], message: str
) -> None:
    for name in files:
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InvalidScanError, match=message):
        open_unposed(tmp_path, format_name, ScanOptions())


def test_a_recording_is_read_in_the_order_of_its_times(tmp_path: Path) -> None:
    with (tmp_path / "recording.zip").open("wb") as file:
        writer = RecordingWriter(file)
        writer.add(0, b"late", 2.0, (0.0, 9.8, 0.0))
        writer.add(1, b"early", 1.0, None)
        writer.close()
    with ZipFile(tmp_path / "recording.zip") as archive:
        archive.extractall(tmp_path / "scan")
    unposed = open_unposed(tmp_path / "scan", None, ScanOptions())
    assert unposed is not None
    assert [path.read_bytes() for path in unposed.photos] == [b"early", b"late"]
    assert [frame.down for frame in unposed.recorded] == [None, (0.0, 1.0, 0.0)]
    with pytest.raises(InvalidScanError, match="2 frames that a phone recorded"):
        open_scan(tmp_path / "scan")


@pytest.mark.parametrize(
    ("listed", "message"),
    [
        ('{"frames": [{"file": "000001.jpg", "time_s": 0}]}', "lists 000001.jpg, which is not in frames"),
        ('{"frames": [{"file": "../a.jpg", "time_s": 0}]}', "recording.json must be"),
        ('{"frames": [{"file": "000000.jpg", "time_s": 0, "down": [0, 0, 0]}]}', "recording.json must be"),
        ("[]", "recording.json must be"),
    ],
)
def test_a_list_of_frames_that_is_wrong_is_named(tmp_path: Path, listed: str, message: str) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "000000.jpg").write_bytes(b"x")
    (tmp_path / "recording.json").write_text(listed, encoding="utf-8")
    with pytest.raises(InvalidScanError, match=message):
        open_unposed(tmp_path, "recording", ScanOptions())


def test_depth_frames_without_a_trajectory(tmp_path: Path) -> None:
    write_tum(tmp_path)
    (tmp_path / "groundtruth.txt").unlink()
    with pytest.raises(InvalidScanError, match='"poses": "estimate"'):
        open_scan(tmp_path, "tum")
    unposed = open_unposed(tmp_path, "auto", ESTIMATE)
    assert unposed is not None
    assert unposed.listed is not None
    assert unposed.listed.has_depth
    assert len(unposed.listed.frames) == 3
    # Where nothing moves only the first picture, and what is asked for by its time, is chosen.
    still = np.kron(np.random.default_rng(0).integers(0, 255, (6, 8, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    for path in (tmp_path / "rgb").iterdir():
        cv2.imwrite(str(path), still)
    chosen = choose_pictures(unposed, ["0.19"], 1, NoProgress())
    assert [frame.timestamp_s for frame in chosen.scan.frames] == [0.0, 0.2]


def test_poses_that_are_there_are_not_used_where_the_options_say_so(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    assert open_unposed(tmp_path, "auto", ScanOptions(camera=CameraHint(values=INTRINSICS))) is None
    unposed = open_unposed(
        tmp_path, "auto", ScanOptions(camera=CameraHint(values=INTRINSICS), estimate_poses=True)
    )
    assert unposed is not None
    assert unposed.listed is not None
    assert unposed.listed.gravity is None


def test_names_alone_say_it() -> None:
    assert recognised(["recording.mp4"])[0].format == "video"
    (photos,) = recognised(["hall/1.jpg", "hall/2.jpg", "hall/3.heic"])
    assert (photos.format, photos.folder, photos.missing) == ("images", "hall", ())
    assert recognised(["hall/1.jpg", "stairs/2.jpg", "stairs/3.jpg"]) == ()
