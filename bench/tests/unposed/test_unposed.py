"""What evaluate-unposed sends is what is read again, and the distance that it states is true."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from app.engine.query.camera_sources import camera_from_tags
from app.geometry.camera_hint import hint_of
from app.importers.archives.archive import names_in_archive
from app.importers.frames import DepthFormat, Frame, Scan, ScanOptions
from app.importers.phones.video import open_video
from app.importers.recognition import recognised
from app.importers.registry import open_unposed
from app.importers.unpack_scan import unpack_scan
from app.vision.exif import read_photo_tags
from bench.tests.formats.scans import OUTER_FOLDERS, packed
from bench.unposed.command import KINDS
from bench.unposed.evaluate import true_pose_of
from bench.unposed.inputs import (
    FPS,
    measured_distance,
    plan_places,
    write_depth_frames,
    write_photos,
    write_video,
)
from tests.scenes import CAMERA, DEPTH_SCALE, Room, encode, pose_at

COUNT = 4


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Scan:
    folder, room, frames = tmp_path_factory.mktemp("scan"), Room(seed=2), []
    for i in range(COUNT):
        view = room.view(pose_at(1.5 + 0.1 * i, 1.2, yaw_deg=60.0 + 5 * i))
        color, depth = folder / f"{i}.png", folder / f"d{i}.png"
        color.write_bytes(view.png())
        depth.write_bytes(encode(np.rint(view.depth_m * DEPTH_SCALE).astype(np.uint16), ".png"))
        frames.append(Frame(f"rgb/{i}.png", 0.1 * i, color, depth, view.world_from_camera))
    return Scan(camera=CAMERA, frames=tuple(frames), discarded={}, depth=DepthFormat(scale=DEPTH_SCALE))


def test_a_video_has_all_frames(scan: Scan, tmp_path: Path) -> None:
    video = open_video(write_video(scan, tmp_path / "walk.mp4"))
    assert (video.width, video.height, video.fps) == (CAMERA.width, CAMERA.height, FPS)
    assert len(list(video.pictures())) == COUNT


def test_photos_are_named_by_their_frame(scan: Scan, tmp_path: Path) -> None:
    folder = write_photos(scan, 2, tmp_path / "photos")
    assert sorted(path.name for path in folder.iterdir()) == ["000000.jpg", "000002.jpg"]
    assert true_pose_of("000002.jpg", 7.0, scan) == scan.frames[2].scan_from_camera


def test_folders_around_pictures_do_not_matter(scan: Scan, tmp_path: Path) -> None:
    photos, frames = write_photos(scan, 1, tmp_path / "photos"), tmp_path / "recording"
    shutil.copytree(photos, frames / "frames")
    listed = [{"file": name, "time_s": i} for i, name in enumerate(sorted(p.name for p in photos.iterdir()))]
    (frames / "recording.json").write_text(json.dumps({"frames": listed}))
    for format_name, written in (("images", photos), ("recording", frames)):
        for number, outer in enumerate(OUTER_FOLDERS):
            archive = packed(written, tmp_path / f"{format_name}-{number}.zip", outer)
            (told,) = recognised(names_in_archive(archive))
            assert (told.format, told.folder) == (format_name, outer.rstrip("/"))
            unposed = open_unposed(unpack_scan(archive, archive.with_suffix("")), None, ScanOptions())
            assert unposed is not None
            assert (unposed.format, [path.name for path in unposed.photos]) == (
                format_name,
                [item["file"] for item in listed],
            )


def test_photos_state_the_focal_length(scan: Scan, tmp_path: Path) -> None:
    folder = write_photos(scan, 2, tmp_path / "photos")
    tags = read_photo_tags((folder / "000002.jpg").read_bytes())
    found = camera_from_tags(tags, CAMERA.width, CAMERA.height)
    assert found.source == "exif"
    assert found.likely is not None
    assert found.likely.focal_px == pytest.approx(CAMERA.focal_px, rel=0.03)


def test_frames_with_depth_have_no_poses(scan: Scan, tmp_path: Path) -> None:
    folder = write_depth_frames(scan, tmp_path / "depth")
    options = ScanOptions(camera=hint_of(CAMERA), depth_scale=DEPTH_SCALE, estimate_poses=True)
    unposed = open_unposed(folder, "tum", options)
    assert unposed is not None
    assert unposed.listed is not None
    assert [frame.timestamp_s for frame in unposed.listed.frames] == pytest.approx(
        [frame.timestamp_s for frame in scan.frames]
    )
    np.testing.assert_allclose(
        unposed.listed.depth_m(unposed.listed.frames[1]), scan.depth_m(scan.frames[1]), atol=1e-3
    )
    assert true_pose_of("rgb/0.200000.png", 0.2, scan) == scan.frames[2].scan_from_camera


def test_the_distance_is_that_of_the_depth(scan: Scan) -> None:
    found = measured_distance(scan, 1)
    assert found.option["frame"] == 1 / FPS
    frame = scan.frames[1]
    u, v = found.pixels.round().astype(int).T
    points = CAMERA.unproject(found.pixels, scan.depth_m(frame)[v, u])
    assert found.distance_m == pytest.approx(float(np.linalg.norm(points[1] - points[0])), rel=0.02)
    assert found.distance_m > 0.5


def test_all_rows_have_a_name() -> None:
    assert len(set(KINDS)) == 5


def test_places_on_the_plan_are_where_the_photos_were_taken(scan: Scan) -> None:
    found = plan_places(scan, 1, np.array([0.0, 0.0, -1.0]))["correspondences"]
    assert {place["frame"] for place in found} == {f"{k:06d}.jpg" for k in range(COUNT)}
    for place in found:
        x, y, _ = scan.frames[int(place["frame"][:6])].scan_from_camera.translation
        assert place["plan"] == pytest.approx([x, y], abs=0.005 + 1e-9)
