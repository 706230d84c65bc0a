"""What phones' apps write in their versions, and what people make of it: the same frames become the same scan."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.importers.registry import find_scan, open_scan
from app.importers.unpack_scan import unpack_scan
from bench.formats import phones
from bench.formats.frames import PHONE_DEPTH
from bench.formats.writers import WRITERS
from bench.tests.formats.changes import CX, CY, FX, FY, Change, both, edited
from bench.tests.formats.scans import CAMERA, FRAMES, HEIGHT, WIDTH, tiny_scan
from bench.tests.formats.test_formats import assert_is


def stray_with_intrinsics(folder: Path, factor: float = 1.0) -> None:
    """Add the columns of newer versions, the last two of which are empty in most rows."""
    path = folder / "odometry.csv"
    header, *rows = path.read_text().splitlines()
    names = "fx, fy, cx, cy, distortion_center_x, distortion_center_y"
    values = ", ".join(str(factor * value) for value in (FX, FY, CX, CY))
    path.write_text("\n".join([f"{header}, {names}", *(f"{row}, {values}, ," for row in rows)]) + "\n")
    (folder / "imu.csv").write_text("timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n")


def as_npy(folder: Path) -> None:
    for kind in ("depth", "confidence"):
        for path in sorted((folder / kind).glob("*.png")):
            np.save(path.with_suffix(".npy"), cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
            path.unlink()


def pictures_of_video(folder: Path, first: int) -> None:
    (folder / "rgb").mkdir()
    for i, frame in enumerate(tiny_scan().frames, start=first):
        (folder / f"rgb/{i:06d}.jpg").write_bytes(frame.jpeg)
    (folder / "rgb.mp4").unlink()


STRAY: dict[str, Change] = {
    "intrinsics in each row": stray_with_intrinsics,
    "intrinsics in each row alone": both(stray_with_intrinsics, lambda f: (f / "camera_matrix.csv").unlink()),
    "depth as arrays": as_npy,
    "pictures from 0": lambda folder: pictures_of_video(folder, 0),
    "pictures from 1": lambda folder: pictures_of_video(folder, 1),
    "rows of another size": lambda folder: stray_with_intrinsics(folder, 3.0),
    "no confidence": lambda folder: shutil.rmtree(folder / "confidence"),
    "files of macOS": lambda folder: [
        (folder / name).write_bytes(b"\0") for name in (".DS_Store", "._rgb.mp4", "depth/._000000.png")
    ],
}


@pytest.mark.parametrize("name", STRAY)
def test_stray_scanner_in_its_versions(tmp_path: Path, name: str) -> None:
    expected = tiny_scan()
    folder = phones.stray_scanner(expected, tmp_path / "scan")
    STRAY[name](folder)
    scan = open_scan(folder)
    assert_is(scan, expected)
    assert scan.has_depth
    assert scan.depth_m(scan.frames[0])[120, 160] == pytest.approx(
        expected.frames[0].depth_m[120, 160], abs=4e-3
    )


def record3d_without_sizes(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    metadata = json.loads(files["metadata"])
    for key in ("dw", "dh", "frameTimestamps"):
        metadata.pop(key)
    files["metadata"] = json.dumps(metadata).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


def exported_as_exr(path: Path, folder: Path) -> Path:
    """Write the app's other export of a recording: EXR images in metres, pictures, and the metadata with a suffix."""
    for i, frame in enumerate(tiny_scan().with_depth_of(*PHONE_DEPTH).frames):
        (folder / "EXR_RGBD/rgb").mkdir(parents=True, exist_ok=True)
        (folder / "EXR_RGBD/depth").mkdir(exist_ok=True)
        (folder / f"EXR_RGBD/rgb/{i}.jpg").write_bytes(frame.jpeg)
        (folder / f"EXR_RGBD/depth/{i}.exr").write_bytes(cv2.imencode(".exr", frame.depth_m)[1].tobytes())
    with zipfile.ZipFile(path) as archive:
        (folder / "EXR_RGBD/metadata.json").write_bytes(archive.read("metadata"))
    return folder


def test_record3d_exported_as_exr(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENCV_IO_ENABLE_OPENEXR", "1")
    expected = tiny_scan()
    folder = exported_as_exr(phones.record3d_plain(expected, tmp_path / "scan"), tmp_path / "export")
    scan = open_scan(folder)
    assert_is(scan, expected)
    assert scan.depth_m(scan.frames[0])[120, 160] == pytest.approx(
        expected.frames[0].depth_m[120, 160], abs=4e-3
    )
    # Intrinsics of each frame come before the matrix; here they are those of another one.
    values = [[FX * 2, FY * 2, 2 * CX + 0.5, 2 * CY + 0.5, 0, 0]] * FRAMES
    change = {"w": 2 * WIDTH, "h": 2 * HEIGHT, "perFrameIntrinsicCoeffs": values, "K": [1.0] * 9}
    edited(folder / "EXR_RGBD/metadata.json", lambda content: content.update(change))
    assert_is(open_scan(folder), expected)


def test_a_recording_of_the_face_id_camera_has_no_way(tmp_path: Path) -> None:
    path = phones.record3d_plain(tiny_scan(), tmp_path / "scan")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "still")
    edited(tmp_path / "still/metadata", lambda content: content.update(poses=[[0.0] * 7] * FRAMES))
    with pytest.raises(InvalidScanError, match=r"All poses of the recording are the same.*LiDAR"):
        open_scan(tmp_path / "still")


NO_TURN = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("initial", [None, NO_TURN, "first", [0.6, 0.0, 0.0, 0.8, 0.1, 0.0, 0.0]])
@pytest.mark.parametrize("from_first", [True, False])
def test_record3d_knows_down_unless_its_poses_count_from_the_first_picture(
    tmp_path: Path, initial: object, from_first: bool
) -> None:
    path = phones.record3d_plain(tiny_scan(), tmp_path / "scan")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unpacked")

    def change(content: dict[str, Any]) -> None:
        poses = content["poses"]
        if from_first:
            poses[0][:4] = NO_TURN[:4]
        content["initPose"] = poses[0] if initial == "first" else initial

    edited(tmp_path / "unpacked/metadata", change)
    scan = open_scan(tmp_path / "unpacked")
    is_known = not from_first and initial in (None, NO_TURN, "first")
    assert scan.gravity == ((0.0, -1.0, 0.0) if is_known else None)
    assert any("down is thus not known" in note for note in scan.notes) != is_known


def test_pictures_of_record3d_that_were_turned_are_refused(tmp_path: Path) -> None:
    path = phones.record3d_plain(tiny_scan(), tmp_path / "scan")
    folder = unpack_scan(path, tmp_path / "unpacked")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "turned")
    edited(tmp_path / "turned/metadata", lambda content: content.update(w=HEIGHT, h=WIDTH))
    with pytest.raises(
        InvalidScanError, match=r"320 x 240 pixels, and its metadata is for 240 x 320: they were turned"
    ):
        open_scan(tmp_path / "turned")
    assert len(open_scan(folder).frames) == FRAMES


def test_an_old_recording_of_record3d_states_no_size_of_its_depth(tmp_path: Path) -> None:
    expected = tiny_scan()
    path = phones.record3d_lzfse(expected, tmp_path / "scan")
    record3d_without_sizes(path)
    scan = open_scan(unpack_scan(path, tmp_path / "unpacked"))
    assert_is(scan, expected)
    assert scan.depth_m(scan.frames[0])[120, 160] == pytest.approx(
        expected.frames[0].depth_m[120, 160], abs=4e-3
    )


@pytest.mark.parametrize(
    ("name", "depth"), [("Polycam raw", "keyframes/depth"), ("3D Scanner App", "depth_*.png")]
)
def test_phones_without_lidar(tmp_path: Path, name: str, depth: str) -> None:
    folder = WRITERS[name](tiny_scan(), tmp_path / "scan")
    for path in folder.glob(depth):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    scan = open_scan(folder)
    assert_is(scan, tiny_scan())
    assert not scan.has_depth
    assert "no depth images" in " ".join(scan.notes)


def test_polycam_beside_its_model_and_video(tmp_path: Path) -> None:
    folder = phones.polycam(tiny_scan(), tmp_path / "scan")
    for name in ("raw.glb", "polycam.mp4", "thumbnail.jpg", "mesh_info.json", "keyframes/cameras/._1.json"):
        (folder / name).write_bytes(b"\0")
    # Refined poses alone: the app leaves the pictures as they are where it changed no lens.
    shutil.move(folder / "keyframes/cameras", folder / "keyframes/corrected_cameras")
    assert find_scan(folder) == (folder, "polycam")
    assert_is(open_scan(folder), tiny_scan())


@pytest.mark.parametrize("size", ["vga_wide", "wide"])
def test_arkitscenes_with_larger_pictures(tmp_path: Path, size: str) -> None:
    folder = phones.arkit_scenes(tiny_scan(), tmp_path / "scan")
    for end in ("", "_intrinsics"):
        shutil.move(folder / f"lowres_wide{end}", folder / f"{size}{end}")
    assert_is(open_scan(folder), tiny_scan())


def test_arkitscenes_with_more_pictures_than_poses(tmp_path: Path) -> None:
    """The original recordings have 60 pictures a second and ten poses: those between are interpolated, not rounded."""
    at_rest = tiny_scan()
    frames = tuple(
        replace(frame, time_s=i / 60, scan_from_camera=Pose(np.eye(3), np.array([i / 100, 0.0, 0.0])))
        for i, frame in enumerate((*at_rest.frames, *at_rest.frames))
    )
    folder = phones.arkit_scenes(replace(at_rest, frames=frames), tmp_path)
    path = folder / "lowres_wide.traj"
    path.write_text("\n".join(path.read_text().splitlines()[:7:6]) + "\n")
    scan = open_scan(folder)
    x = [frame.scan_from_camera.translation[0] for frame in scan.frames]
    # Seven up to the second pose, and one within the tolerance behind it.
    np.testing.assert_allclose(x, [*(i / 100 for i in range(7)), 0.06], atol=1e-3)
    assert len(scan.discarded["no_pose"]) == 2


def test_new_versions_of_polycam_state_no_size_of_corrected_pictures(tmp_path: Path) -> None:
    folder = phones.polycam(tiny_scan(), tmp_path / "scan")
    for kind in ("cameras", "images"):
        shutil.copytree(folder / f"keyframes/{kind}", folder / f"keyframes/corrected_{kind}")
    for path in (folder / "keyframes/corrected_cameras").iterdir():
        edited(path, lambda content: [content.pop(key) for key in ("width", "height")])
    assert open_scan(folder).frames[0].name.startswith("keyframes/corrected_images")
    assert_is(open_scan(folder), tiny_scan())
    # Most of the corrected pictures are missing: those that are complete are read.
    for path in sorted((folder / "keyframes/corrected_images").iterdir())[:4]:
        path.unlink()
    assert open_scan(folder).frames[0].name.startswith("keyframes/images")
    assert_is(open_scan(folder), tiny_scan())


def test_a_principal_point_that_moves_with_the_stabiliser(tmp_path: Path) -> None:
    """The pictures of a phone whose sensor moves are resampled, and so is their depth, without its low confidence."""
    folder = phones.polycam(tiny_scan(), tmp_path / "scan")
    cameras = sorted((folder / "keyframes/cameras").iterdir())
    for path in sorted((folder / "keyframes/confidence").iterdir()):
        confidence = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        confidence[:, :40] = 0
        cv2.imwrite(str(path), confidence)
    edited(cameras[1], lambda content: content.update(cx=content["cx"] + 8, cy=content["cy"] - 4))
    scan = open_scan(folder)
    assert scan.camera.params[:4] == CAMERA.params[:4]
    assert any("1 of 5 were resampled" in note for note in scan.notes)
    # What the moved picture has at (168, 114) is seen at (160, 118).
    expected = tiny_scan().frames[1]
    seen = cv2.imdecode(np.frombuffer(scan.color_bytes(scan.frames[1]), np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(seen[118, 160].astype(int) - expected.bgr[114, 168].astype(int)).max() <= 6
    depth_m = scan.depth_m(scan.frames[1])
    assert depth_m[118, 160] == pytest.approx(expected.depth_m[114, 168], abs=5e-3)
    assert not depth_m[:, :35].any()
    assert depth_m[118, 60] > 0
