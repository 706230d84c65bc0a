"""Layouts of data sets and tools in their variants: the same frames become the same scan."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.importers.frames import ScanOptions
from app.importers.recognition import recognised
from app.importers.registry import open_scan
from bench.formats import layouts
from bench.tests.formats.changes import CX, CY, FX, FY, Change, both, each_frame, edited, top
from bench.tests.formats.scans import CAMERA, FRAMES, HEIGHT, WIDTH, tiny_scan
from bench.tests.formats.test_formats import assert_is


def without_suffix(frame: dict[str, Any]) -> None:
    frame["file_path"] = frame["file_path"].removesuffix(".jpg")


def of_another_computer(frame: dict[str, Any]) -> None:
    frame["file_path"] = f"/home/me/captures/room/{frame['file_path']}"
    frame["depth_file_path"] = "C:\\captures\\room\\" + frame["depth_file_path"].replace("/", "\\")


def as_nerf_capture(frame: dict[str, Any]) -> None:
    frame["depth_path"] = frame.pop("depth_file_path")
    without_suffix(frame)


def leading_out(frame: dict[str, Any]) -> None:
    frame.update({key: f"../{frame[key]}" for key in ("file_path", "depth_file_path")})


def beside(folder: Path) -> None:
    (folder / "nerf").mkdir()
    (folder / "transforms.json").rename(folder / "nerf/transforms.json")


def camera_in_each_frame(folder: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        camera = {key: content.pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
        for frame in content["frames"]:
            frame.update(camera)

    edited(folder / "transforms.json", change)


VIEW_X, VIEW_Y = (float(2 * np.arctan(size / 2 / f)) for size, f in ((WIDTH, FX), (HEIGHT, FY)))


NERFSTUDIO: dict[str, Change] = {
    "without suffix": each_frame(without_suffix),
    "backslashes": each_frame(lambda f: f.update(file_path=".\\" + f["file_path"].replace("/", "\\"))),
    "paths of another computer": each_frame(of_another_computer),
    "angles of view": top(fl_x=None, fl_y=None, camera_angle_x=VIEW_X, camera_angle_y=VIEW_Y),
    "no size": top(w=None, h=None),
    "NeRFCapture": both(each_frame(as_nerf_capture), top(integer_depth_scale=0.001)),
    "camera in each frame": camera_in_each_frame,
    "a simple model": top(camera_model="SIMPLE_RADIAL", k1=0.0, k2=0.0, k3=0.0),
    "a model in small letters": top(camera_model="pinhole"),
    "in a folder beside the pictures": both(each_frame(leading_out), beside),
    "split": lambda folder: (folder / "transforms.json").rename(folder / "transforms_train.json"),
}


@pytest.mark.parametrize("name", NERFSTUDIO)
def test_nerfstudio_as_tools_write_it(tmp_path: Path, name: str) -> None:
    expected = tiny_scan()
    folder = layouts.nerfstudio(expected, tmp_path / "scan")
    NERFSTUDIO[name](folder)
    scan = open_scan(folder)
    assert_is(scan, expected)
    assert scan.depth_m(scan.frames[0])[120, 160] == pytest.approx(
        expected.frames[0].depth_m[120, 160], abs=2e-3
    )


def test_depth_of_nerfstudio_in_another_unit(tmp_path: Path) -> None:
    expected = tiny_scan()
    folder = layouts.nerfstudio(expected, tmp_path)
    for path in (folder / "depth").iterdir():
        cv2.imwrite(str(path), 4 * cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    top(depth_unit_scale_factor=0.00025)(folder)
    scan = open_scan(folder)
    np.testing.assert_allclose(scan.depth_m(scan.frames[1]), expected.frames[1].depth_m, atol=1e-3)


def test_a_lens_of_nerfstudio_with_a_third_coefficient(tmp_path: Path) -> None:
    folder = layouts.nerfstudio(tiny_scan(), tmp_path)
    top(k1=0.1, k2=-0.05, p1=0.001, p2=0.002, k3=0.01)(folder)
    camera = open_scan(folder).camera
    assert (camera.model, camera.params[4:9]) == ("FULL_OPENCV", (0.1, -0.05, 0.001, 0.002, 0.01))


def of_focal(f: float, k1: float) -> Camera:
    return Camera("OPENCV", WIDTH, HEIGHT, (f, f, CX, CY, k1, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("k1", [0.0, 0.08])
def test_pictures_of_several_cameras_become_those_of_one(tmp_path: Path, k1: float) -> None:
    """A grid of points seen by cameras of other focal lengths is seen at the pixels of the common camera."""
    folder = layouts.nerfstudio(tiny_scan(), tmp_path)
    focal = [280.0, 250.0, 310.0, 290.0, 270.0]
    points = np.array(
        [((u - CX) / 280.0, (v - CY) / 280.0, 1.0) for u in range(60, 300, 80) for v in range(50, 220, 60)]
    )
    for f, path in zip(focal, sorted((folder / "images").iterdir()), strict=True):
        dots = np.zeros((HEIGHT, WIDTH), np.uint8)
        for u, v in of_focal(f, k1).project(points):
            cv2.circle(dots, (round(4 * u), round(4 * v)), 12, 255, -1, shift=2)
        cv2.imwrite(str(path), dots)
    left = iter(focal)
    top(k1=k1)(folder)
    each_frame(lambda frame: frame.update(dict.fromkeys(("fl_x", "fl_y"), next(left))))(folder)
    scan = open_scan(folder)
    assert scan.camera.params[0] == 280
    assert "4 of 5 were resampled" in " ".join(scan.notes)
    for frame in scan.frames:
        seen = cv2.imdecode(np.frombuffer(scan.color_bytes(frame), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert seen is not None
        assert seen.shape == (HEIGHT, WIDTH)
        assert all(seen[round(v), round(u)] > 200 for u, v in of_focal(280.0, k1).project(points))
        depth_m = scan.depth_m(frame)
        assert depth_m.shape == (HEIGHT, WIDTH)
        # The slope under the middle ray is where it was; elsewhere it moved with the picture.
        assert depth_m[round(CY), round(CX)] == pytest.approx(1.0 + 0.002 * CX + 0.003 * CY, abs=0.01)
    each_frame(lambda frame: frame.update(fl_x=600.0, fl_y=600.0) if "00002" in frame["file_path"] else None)(
        folder
    )
    with pytest.raises(InvalidScanError, match=r"00002\.jpg has another focal length"):
        open_scan(folder)


def colmap_with(folder: Path, cameras: list[str], camera_of: Callable[[int], int]) -> Path:
    """Write a COLMAP model whose i-th picture has the camera of that number."""
    layouts.colmap_text(tiny_scan(), folder)
    (folder / "sparse/0/cameras.txt").write_text("\n".join(cameras) + "\n")
    path = folder / "sparse/0/images.txt"
    lines = path.read_text().splitlines()
    for i in range(FRAMES):
        cells = lines[1 + 2 * i].split()
        lines[1 + 2 * i] = " ".join([*cells[:8], str(camera_of(i)), cells[9]])
    path.write_text("\n".join(lines) + "\n")
    return folder


def test_a_colmap_model_with_a_camera_for_each_picture(tmp_path: Path) -> None:
    same = [f"{i + 1} PINHOLE {WIDTH} {HEIGHT} {FX} {FY} {CX + 0.5} {CY + 0.5}" for i in range(FRAMES)]
    scan = open_scan(colmap_with(tmp_path / "same", same, lambda i: i + 1))
    assert_is(scan, tiny_scan())
    assert not any("resampled" in note for note in scan.notes)
    others = [
        f"{i + 1} SIMPLE_RADIAL {WIDTH} {HEIGHT} {FX + i} {CX + 0.5} {CY + 0.5} 0.01" for i in range(FRAMES)
    ]
    scan = open_scan(colmap_with(tmp_path / "others", others, lambda i: i + 1))
    assert scan.camera.params[0] == FX + 2
    assert any("4 of 5 were resampled" in note for note in scan.notes)
    assert len(scan.frames) == FRAMES


def test_a_colmap_model_with_files_of_newer_versions_and_without_points(tmp_path: Path) -> None:
    folder = layouts.colmap_binary(tiny_scan(), tmp_path)
    for name in ("rigs.bin", "frames.bin"):
        (folder / "sparse/0" / name).write_bytes(struct.pack("<Q", 0))
    (folder / "sparse/0/points3D.bin").unlink()
    assert_is(open_scan(folder), tiny_scan())


@pytest.mark.parametrize("points", [None, "", "1.5 2.5 -1 3.5 4.5 7 8.5 9.5 -1 10.5 11.5 12", "# none"])
def test_lines_of_points_in_a_colmap_model(tmp_path: Path, points: str | None) -> None:
    folder = layouts.colmap_text(tiny_scan(), tmp_path)
    path = folder / "sparse/0/images.txt"
    pictures = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    between = "" if points is None else f"{points}\n"
    path.write_text("# pictures\n" + "".join(f"{line}\n{between}" for line in pictures))
    assert_is(open_scan(folder), tiny_scan())


def test_depth_that_a_network_guessed_is_not_read_beside_a_colmap_model(tmp_path: Path) -> None:
    folder = layouts.colmap_binary(tiny_scan(), tmp_path)
    assert open_scan(folder).has_depth
    (folder / "sparse/0/depth_params.json").write_text(json.dumps({"000000": {"scale": 0.7, "offset": 0.1}}))
    scan = open_scan(folder)
    assert_is(scan, tiny_scan())
    assert not scan.has_depth
    assert any("inverse distances" in note for note in scan.notes)


def test_a_colmap_model_of_scannet_plus_plus(tmp_path: Path) -> None:
    folder = layouts.colmap_text(tiny_scan(), tmp_path / "scene") / "dslr"
    folder.mkdir()
    shutil.move(folder.parent / "images", folder / "resized_images")
    shutil.move(folder.parent / "sparse/0", folder / "colmap")
    shutil.rmtree(folder.parent / "depth")
    # Its list for nerfstudio names the pictures without their folder.
    frames = [{"file_path": f"{i:06d}.jpg", "transform_matrix": np.eye(4).tolist()} for i in range(FRAMES)]
    (folder / "nerfstudio").mkdir()
    (folder / "nerfstudio/transforms.json").write_text(json.dumps({"frames": frames}))
    assert_is(open_scan(tmp_path), tiny_scan())
    (found,) = recognised(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*"))
    assert (found.format, found.folder, found.missing) == ("colmap", "scene/dslr", ())


def test_of_several_colmap_models_the_largest_is_read(tmp_path: Path) -> None:
    folder = layouts.colmap_text(tiny_scan(), tmp_path)
    shutil.move(folder / "sparse/0", folder / "sparse/1")
    shutil.copytree(folder / "sparse/1", folder / "sparse/0")
    first = (folder / "sparse/0/images.txt").read_text().splitlines()[:3]
    (folder / "sparse/0/images.txt").write_text("\n".join(first) + "\n")
    assert_is(open_scan(folder), tiny_scan())


def test_a_colmap_fisheye_of_two_coefficients(tmp_path: Path) -> None:
    folder = colmap_with(
        tmp_path, [f"1 RADIAL_FISHEYE {WIDTH} {HEIGHT} 280 161.5 118.5 0.02 0.01"], lambda _: 1
    )
    camera = open_scan(folder).camera
    assert (camera.model, camera.params) == ("OPENCV_FISHEYE", (280, 280, 161, 118, 0.02, 0.01, 0, 0))


def open3d_trajectory(folder: Path) -> None:
    (folder / "trajectory.log").unlink()
    (folder / "intrinsic.json").unlink()
    matrix = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
    cameras = [
        {
            "class_name": "PinholeCameraParameters",
            "extrinsic": frame.scan_from_camera.inverse().matrix.T.ravel().tolist(),
            "intrinsic": {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": matrix},
        }
        for frame in tiny_scan().frames
    ]
    content = {"class_name": "PinholeCameraTrajectory", "parameters": cameras}
    (folder / "camera_trajectory.json").write_text(json.dumps(content))


def with_depth_scale(folder: Path) -> None:
    edited(folder / "intrinsic.json", lambda content: content.update(depth_scale=2000.0))
    for path in (folder / "depth").iterdir():
        cv2.imwrite(str(path), 2 * cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


REDWOOD: dict[str, Change] = {
    "a JSON trajectory": open3d_trajectory,
    "a log named txt": lambda folder: (folder / "trajectory.log").rename(folder / "livingroom1-traj.txt"),
    "an intrinsic file of another name": lambda f: (f / "intrinsic.json").rename(
        f / "camera_primesense.json"
    ),
    "depth of another scale": with_depth_scale,
    "files of macOS": lambda folder: [
        (folder / name).write_bytes(b"\0") for name in ("color/._000000.jpg", "depth/.DS_Store")
    ],
}


@pytest.mark.parametrize("name", REDWOOD)
def test_open3d_as_its_tools_write_it(tmp_path: Path, name: str) -> None:
    expected = tiny_scan()
    folder = layouts.redwood(expected, tmp_path / "scan")
    REDWOOD[name](folder)
    scan = open_scan(folder)
    assert_is(scan, expected)
    np.testing.assert_allclose(scan.depth_m(scan.frames[2]), expected.frames[2].depth_m, atol=1e-3)


def scannet_of_25k(folder: Path) -> None:
    for kind in ("color", "depth"):
        shutil.move(folder / f"intrinsic/intrinsic_{kind}.txt", folder / f"intrinsics_{kind}.txt")
    shutil.rmtree(folder / "intrinsic")


def scannet_with_scene_file(folder: Path) -> None:
    shutil.rmtree(folder / "intrinsic")
    rows = [
        f"{key}_{kind} = {value}"
        for kind in ("color", "depth")
        for key, value in zip(("fx", "fy", "mx", "my"), (FX, FY, CX, CY), strict=True)
    ]
    (folder / "scene0000_00.txt").write_text("\n".join(["axisAlignment = 1 0 0 0", *rows]) + "\n")


def with_other_zeros(folder: Path) -> None:
    for path in sorted((folder / "depth").iterdir()):
        path.rename(path.with_name(f"{int(path.stem):06d}.png"))


@pytest.mark.parametrize("change", [scannet_of_25k, scannet_with_scene_file, with_other_zeros])
def test_scannet_as_tools_write_it(tmp_path: Path, change: Change) -> None:
    folder = layouts.scannet(tiny_scan(), tmp_path / "scan")
    change(folder)
    assert_is(open_scan(folder), tiny_scan())


@pytest.mark.parametrize("key", ["m_calibrationColorExtrinsic", "m_calibrationDepthExtrinsic"])
def test_cameras_of_12_scenes_that_are_apart_are_not_taken_to_be_in_one_place(
    tmp_path: Path, key: str
) -> None:
    folder = layouts.twelve_scenes(tiny_scan(), tmp_path)
    info = (folder / "info.txt").read_text()
    (folder / "info.txt").write_text(f"{info}\n{key} = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n")
    assert_is(open_scan(folder), tiny_scan())
    (folder / "info.txt").write_text(f"{info}\n{key} = 1 0 0 0.025 0 1 0 0 0 0 1 0 0 0 0 1\n")
    with pytest.raises(InvalidScanError, match="colour and depth camera are apart"):
        open_scan(folder)


def test_a_depth_camera_of_kapture_is_where_its_rig_says(tmp_path: Path) -> None:
    expected = tiny_scan()
    folder = layouts.kapture(expected, tmp_path)
    np.testing.assert_array_equal(open_scan(folder).depth.color_from_depth.matrix, np.eye(4))
    # The rig is the colour camera; the depth camera is 5 cm to the right of it.
    (folder / "sensors/rigs.txt").write_text(
        "# kapture format: 1.1\nrig, cam, 1, 0, 0, 0, 0, 0, 0\nrig, tof, 1, 0, 0, 0, -0.05, 0, 0\n"
    )
    path = folder / "sensors/trajectories.txt"
    path.write_text(path.read_text().replace(", cam,", ", rig,"))
    scan = open_scan(folder)
    assert_is(scan, expected)
    np.testing.assert_allclose(scan.depth.color_from_depth.translation, [0.05, 0, 0], atol=1e-9)


def test_an_export_of_rtabmap_with_one_calibration_for_all(tmp_path: Path) -> None:
    folder = layouts.rtabmap_export(tiny_scan(), tmp_path)
    shutil.move(folder / "rtabmap_calib/1.yaml", folder / "rtabmap_calib.yaml")
    shutil.rmtree(folder / "rtabmap_calib")
    assert_is(open_scan(folder), tiny_scan())


def test_poses_of_rtabmap_without_times_are_asked_for_with_them(tmp_path: Path) -> None:
    folder = layouts.rtabmap_export(tiny_scan(), tmp_path)
    rows = [" ".join(map(str, frame.scan_from_camera.matrix[:3].ravel())) for frame in tiny_scan().frames]
    (folder / "rtabmap_poses.txt").write_text("\n".join(rows) + "\n")
    with pytest.raises(InvalidScanError, match=r"rtabmap_poses\.txt names neither times .*--poses_format 11"):
        open_scan(folder)


def test_an_export_of_rtabmap_with_several_cameras(tmp_path: Path) -> None:
    folder = layouts.rtabmap_export(tiny_scan(), tmp_path)
    for path in sorted((folder / "rtabmap_calib").iterdir()):
        shutil.copy(path, path.with_name(f"{path.stem}_0.yaml"))
        path.rename(path.with_name(f"{path.stem}_1.yaml"))
    with pytest.raises(InvalidScanError, match=r"1\.jpg is of several cameras, by 1_0\.yaml"):
        open_scan(folder)


def test_a_camera_of_kapture_that_was_never_calibrated_is_asked_for(tmp_path: Path) -> None:
    folder = layouts.kapture(tiny_scan(), tmp_path)
    path = folder / "sensors/sensors.txt"
    known = next(line for line in path.read_text().splitlines() if line.startswith("cam"))
    path.write_text(path.read_text().replace(known, f"cam, , camera, UNKNOWN_CAMERA, {WIDTH}, {HEIGHT}"))
    with pytest.raises(InvalidScanError, match=r"no camera 'cam' of a model that is known: give `camera`"):
        open_scan(folder)
    given = ScanOptions(camera=CameraHint(values=CAMERA.params))
    assert_is(open_scan(folder, None, given), tiny_scan())
