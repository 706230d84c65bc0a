"""Scans as other tools lay them out: the same frames in each layout become the same scan."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.frames import Scan, ScanOptions
from app.importers.recognition import recognised
from app.importers.registry import open_scan
from tests.importers.scans import HEIGHT, INTRINSICS, WIDTH, assert_has_no_depth, write_color, write_depth

FRAMES = 5
# From camera axes (y down, z forward) to those of OpenGL and ARKit (y up, z back), and back.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
SLOPE = np.add.outer(np.arange(HEIGHT // 2), 2 * np.arange(WIDTH // 2) + 1000).astype(np.uint16)


def poses() -> list[Pose]:
    """Return `world_from_camera` of each frame, none of them symmetric in anything."""
    rng = np.random.default_rng(5)
    turns = rng.normal(size=(FRAMES, 4))
    return [Pose.from_quaternion(rng.normal(size=3), q / np.linalg.norm(q)) for q in turns]


def images(folder: Path, color: str, depth: str, half: bool = True) -> None:
    """Write colour and depth of each frame; the depth of half the size is a slope."""
    for i in range(FRAMES):
        write_color(folder / color.format(i))
        write_depth(folder / depth.format(i), SLOPE if half else 1500)


def nerfstudio(folder: Path) -> Path:
    images(folder, "images/frame_{:05d}.png", "depth/frame_{:05d}.png")
    fx, fy, cx, cy = INTRINSICS
    content = {
        "camera_model": "OPENCV", "fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": WIDTH, "h": HEIGHT,
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
        "frames": [
            {
                "file_path": f"./images/frame_{i:05d}.png",
                "depth_file_path": f"depth/frame_{i:05d}.png",
                "transform_matrix": (pose.matrix @ FLIP).tolist(),
            }
            for i, pose in enumerate(poses())
        ],
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def polycam(folder: Path, kind: str = "") -> Path:
    images(folder, f"keyframes/{kind}images/100{{}}.png", "keyframes/depth/100{}.png")
    fx, fy, cx, cy = INTRINSICS
    (folder / f"keyframes/{kind}cameras").mkdir(parents=True)
    for i, pose in enumerate(poses()):
        matrix = pose.matrix @ FLIP
        entry = {
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "width": WIDTH,
            "height": HEIGHT,
            "timestamp": 1e6 * i,
        }
        entry |= {f"t_{r}{c}": matrix[r, c] for r in range(3) for c in range(4)}
        (folder / f"keyframes/{kind}cameras/100{i}.json").write_text(json.dumps(entry))
    return folder


def matrix_text(matrix: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    return "\n".join(" ".join(f"{v:.8f}" for v in row) for row in matrix)


def scannet(folder: Path) -> Path:
    images(folder, "color/{}.png", "depth/{}.png")
    for name in ("pose", "intrinsic"):
        (folder / name).mkdir()
    for i, pose in enumerate(poses()):
        (folder / f"pose/{i}.txt").write_text(matrix_text(pose.matrix))
    K = np.eye(4)
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = INTRINSICS
    (folder / "intrinsic/intrinsic_color.txt").write_text(matrix_text(K))
    K[:2] /= 2
    K[:2, 2] -= 0.25
    (folder / "intrinsic/intrinsic_depth.txt").write_text(matrix_text(K))
    (folder / "intrinsic/extrinsic_color.txt").write_text(matrix_text(np.eye(4)))
    return folder


def redwood(folder: Path) -> Path:
    images(folder, "image/{:07d}.png", "depth/{:07d}.png", half=False)
    lines = [f"{i} {i} {i + 1}\n{matrix_text(pose.matrix)}" for i, pose in enumerate(poses())]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    fx, fy, cx, cy = INTRINSICS
    content = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": [fx, 0, 0, 0, fy, 0, cx, cy, 1]}
    (folder / "camera_intrinsic.json").write_text(json.dumps(content))
    return folder


WRITERS: dict[str, Callable[[Path], Path]] = {
    "nerfstudio": nerfstudio,
    "polycam": polycam,
    "scannet": scannet,
    "redwood": redwood,
}


def assert_is_the_scan(scan: Scan) -> None:
    assert len(scan.frames) == FRAMES
    assert scan.discarded == {}
    assert scan.camera.params[:4] == pytest.approx(INTRINSICS)
    for frame, pose in zip(scan.frames, poses(), strict=True):
        np.testing.assert_allclose(frame.scan_from_camera.matrix, pose.matrix, atol=1e-6)
    assert (np.diff([frame.timestamp_s for frame in scan.frames]) > 0).all()


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("asked", [True, False])
def test_the_same_scan_in_every_layout(tmp_path: Path, name: str, asked: bool) -> None:
    scan = open_scan(WRITERS[name](tmp_path / "export").parent, name if asked else None)
    assert_is_the_scan(scan)
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m.shape == (HEIGHT, WIDTH)
    if name == "redwood":
        assert depth_m[5, 5] == 1.5
    else:
        # Half-size depth is registered to the colour image: its slope goes on at twice the resolution.
        centre = SLOPE[HEIGHT // 4 - 1 : HEIGHT // 4 + 1, WIDTH // 4 - 1 : WIDTH // 4 + 1].mean() / 1000
        assert depth_m[
            HEIGHT // 2 - 1 : HEIGHT // 2 + 1, WIDTH // 2 - 1 : WIDTH // 2 + 1
        ].mean() == pytest.approx(centre, abs=2e-3)


@pytest.mark.parametrize("name", WRITERS)
def test_a_camera_in_the_options_comes_first(tmp_path: Path, name: str) -> None:
    options = ScanOptions(camera=CameraHint(values=(61.0, 61.0, 31.5, 23.5)), depth_scale=500.0)
    scan = open_scan(WRITERS[name](tmp_path), None, options)
    assert scan.camera.params[0] == 61
    assert scan.depth.scale == 500


@pytest.mark.parametrize("name", WRITERS)
def test_missing_files_are_named(tmp_path: Path, name: str) -> None:
    folder = WRITERS[name](tmp_path)
    depth = next(folder.rglob("depth"))
    first = sorted(depth.iterdir())[0]
    first.unlink()
    if name == "redwood":
        with pytest.raises(InvalidScanError, match=r"has 5 poses for 5 colour and 4 depth images"):
            open_scan(folder)
        return
    scan = open_scan(folder)
    assert scan.has_depth
    assert len(scan.frames) == FRAMES - 1
    assert sum(len(names) for names in scan.discarded.values()) == 1


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("keeps_folder", [True, False])
def test_without_any_depth_image_the_frames_have_none(tmp_path: Path, name: str, keeps_folder: bool) -> None:
    folder = WRITERS[name](tmp_path / "export")
    depth = next(folder.rglob("depth"))
    shutil.rmtree(depth)
    if keeps_folder:
        depth.mkdir()
    scan = open_scan(folder.parent)
    assert_is_the_scan(scan)
    assert_has_no_depth(scan, FRAMES)


@pytest.mark.parametrize("name", ["nerfstudio", "scannet", "redwood"])
def test_depth_under_other_names_is_not_ignored(tmp_path: Path, name: str) -> None:
    folder = WRITERS[name](tmp_path)
    (folder / "depth").rename(folder / "depthmaps")
    with pytest.raises(InvalidScanError, match="depth"):
        open_scan(folder)


def edited(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_nerfstudio_details(tmp_path: Path) -> None:
    folder = nerfstudio(tmp_path)
    path = folder / "transforms.json"

    def scaled(content: dict[str, Any]) -> None:
        content["applied_scale"] = 0.5
        content["camera_model"] = "OPENCV_FISHEYE"
        content["frames"].reverse()
        for frame in content["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= 0.5

    edited(path, scaled)
    scan = open_scan(folder)
    assert scan.camera.model == "OPENCV_FISHEYE"
    assert_is_the_scan(scan)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("frames"), "lists no frames"),
        (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "'EQUIRECTANGULAR' is not known"),
        (lambda c: c.update(fl_x="wide"), "fl_x must be a number"),
        (lambda c: c.pop("fl_x"), "fl_x must be a number"),
        (lambda c: c.update(depth_unit_scale_factor=-1), "depth_unit_scale_factor must be above 0"),
        (lambda c: c["frames"][2].update(fl_x=90.0), "images/frame_00002.png has another focal length"),
        (
            lambda c: c["frames"][0].update(transform_matrix=[1, 2]),
            "transform_matrix must be a matrix of four",
        ),
        (lambda c: c["frames"][0].update(file_path="../../x.png"), "must lie inside"),
        (lambda c: [f.update(transform_matrix=[[0.0] * 4] * 4) for f in c["frames"]], "5 of 5 poses"),
    ],
)
def test_nerfstudio_refusals(tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str) -> None:
    folder = nerfstudio(tmp_path)
    edited(folder / "transforms.json", change)
    with pytest.raises(InvalidScanError, match=message):
        open_scan(folder)


@pytest.mark.parametrize(
    "text", ["{", "[]", "[" * 100_000, '{"frames": NaN}', '{"frames": [], "fl_x": ' + "9" * 400 + "}"]
)
def test_json_that_is_not_this(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InvalidScanError, match=r"transforms\.json"):
        open_scan(tmp_path)


def test_polycam_prefers_its_corrected_poses_and_knows_down(tmp_path: Path) -> None:
    polycam(tmp_path)
    for path in (tmp_path / "keyframes/cameras").iterdir():
        edited(path, lambda c: c.update(t_03=100.0))
    assert open_scan(tmp_path).frames[0].scan_from_camera.translation[0] == 100
    polycam(tmp_path, "corrected_")
    scan = open_scan(tmp_path)
    assert_is_the_scan(scan)
    assert scan.gravity == (0.0, -1.0, 0.0)


@pytest.mark.parametrize("kind", ["", "corrected_"])
def test_what_lies_in_keyframes_of_polycam_is_a_scan(tmp_path: Path, kind: str) -> None:
    polycam(tmp_path, kind)
    scan = open_scan(tmp_path / "keyframes")
    assert_is_the_scan(scan)
    assert scan.frames[0].name == f"{kind}images/1000.png"
    names = (path.relative_to(tmp_path / "keyframes").as_posix() for path in tmp_path.rglob("*.*"))
    (found,) = recognised(names)
    assert (found.format, found.folder, found.missing) == ("polycam", "", ())


def test_cameras_of_other_tools_are_not_those_of_polycam(tmp_path: Path) -> None:
    polycam(tmp_path)
    for path in (tmp_path / "keyframes/cameras").iterdir():
        edited(path, lambda c: c.pop("t_00"))
    with pytest.raises(InvalidScanError, match="can't be told from its files"):
        open_scan(tmp_path / "keyframes")


def test_scannet_details(tmp_path: Path) -> None:
    folder = scannet(tmp_path)
    (folder / "pose/2.txt").write_text("-inf -inf -inf -inf\n" * 4)
    assert open_scan(folder).discarded == {"invalid_pose": ("color/2.png",)}
    (folder / "intrinsic/intrinsic_color.txt").write_text("120 0 63.5 0\n0 120 47.5 0\n0 0 1 0\n0 0 0 1\n")
    with pytest.raises(
        InvalidScanError, match=r"64 x 48 pixels, but intrinsic_color\.txt is for about 127 x 95"
    ):
        open_scan(folder)
    assert (
        len(open_scan(folder, None, ScanOptions(camera=CameraHint(values=INTRINSICS))).frames) == FRAMES - 1
    )
    shifted = np.eye(4)
    shifted[0, 3] = 0.03
    (folder / "intrinsic/extrinsic_color.txt").write_text(matrix_text(shifted))
    with pytest.raises(InvalidScanError, match=r"colour and depth camera are apart: give depth_camera"):
        open_scan(folder, None, ScanOptions(camera=CameraHint(values=INTRINSICS)))


def test_redwood_refusals(tmp_path: Path) -> None:
    folder = redwood(tmp_path)
    text = (folder / "trajectory.log").read_text()
    (folder / "second.log").write_text(text)
    with pytest.raises(
        InvalidScanError, match=r"2 trajectories, second\.log and trajectory\.log: send only one"
    ):
        open_scan(folder)
    (folder / "second.log").write_text("INFO: started\n")
    assert_is_the_scan(open_scan(folder))
    (folder / "trajectory.log").write_text("\n".join(text.splitlines()[:-1]))
    with pytest.raises(InvalidScanError, match=r"has 24 rows; each pose has 5"):
        open_scan(folder)
    (folder / "trajectory.log").write_text(text)
    (folder / "camera_intrinsic.json").unlink()
    with pytest.raises(InvalidScanError, match=r"add intrinsic\.json"):
        open_scan(folder)
