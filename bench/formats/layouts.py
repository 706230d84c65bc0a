"""Scans in the layouts of data sets and of other programs."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.geometry.se3 import Pose
from bench.formats.frames import WrittenScan, pose_text, rows_of, write_files
from bench.formats.phones import FLIP

Files = dict[str, bytes | str]
WXYZ = (3, 0, 1, 2)


def tum(scan: WrittenScan, target: Path, trajectory: str = "groundtruth.txt", every: int = 1) -> Path:
    """Write the TUM layout; of the poses one in `every`."""
    files = _tum_images(scan)
    rows = [f"{f.time_s:.6f} {pose_text(f.scan_from_camera)}" for f in scan.frames[::every]]
    files[trajectory] = "\n".join(rows) + "\n"
    for kind, suffix in (("rgb", "jpg"), ("depth", "png")):
        lines = [f"{f.time_s:.6f} {kind}/{i:06d}.{suffix}" for i, f in enumerate(scan.frames)]
        files[f"{kind}.txt"] = "\n".join(lines) + "\n"
    return write_files(target, files)


def _tum_images(scan: WrittenScan) -> Files:
    fx, fy, cx, cy = scan.camera.params[:4]
    size = f"{scan.camera.width} {scan.camera.height}"
    files: Files = {"camera.txt": f"# depth_scale = 1000 per metre\nPINHOLE {size} {fx} {fy} {cx} {cy}\n"}
    for i, frame in enumerate(scan.frames):
        files[f"rgb/{i:06d}.jpg"] = frame.jpeg
        files[f"depth/{i:06d}.png"] = frame.depth_png
    return files


def orb_slam(scan: WrittenScan, target: Path) -> Path:
    """Write the TUM layout with ORB-SLAM's two trajectories: of all frames, and of keyframes alone."""
    tum(scan, target, "CameraTrajectory.txt")
    keyframes = [f"{f.time_s:.6f} {pose_text(f.scan_from_camera)}" for f in scan.frames[::3]]
    return write_files(target, {"KeyFrameTrajectory.txt": "\n".join(keyframes) + "\n"})


def icl_nuim(scan: WrittenScan, target: Path) -> Path:
    """Write ICL-NUIM's form of the TUM layout: depth first, numbers of frames for times, y of the camera up."""
    files = _tum_images(scan)
    frames = enumerate(scan.frames)
    files["associations.txt"] = "".join(f"{i} depth/{i:06d}.png {i} rgb/{i:06d}.jpg\n" for i, _ in frames)
    # Its cameras and its world are left-handed: y of both is turned over.
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    poses = [Pose.from_matrix(mirror @ f.scan_from_camera.matrix @ mirror) for f in scan.frames]
    files["livingRoom0.gt.freiburg"] = "".join(f"{i} {pose_text(pose)}\n" for i, pose in enumerate(poses))
    return write_files(target, files)


def seven_scenes(scan: WrittenScan, target: Path) -> Path:
    """Write the layout of 7-Scenes with a camera file."""
    files = _numbered(scan, "seq-01")
    files["camera.txt"] = _tum_images(scan)["camera.txt"]
    return write_files(target, files)


def twelve_scenes(scan: WrittenScan, target: Path) -> Path:
    """Write the layout of 12-Scenes, with depth of half the size."""
    half = scan.camera.scaled_to(scan.camera.width // 2, scan.camera.height // 2)
    scan = scan.with_depth_of(half.width, half.height)
    files = _numbered(scan, "data")
    info = {
        "m_versionNumber": "4",
        "m_colorWidth": str(scan.camera.width),
        "m_depthShift": "1000",
        "m_calibrationColorIntrinsic": _matrix_line(scan.matrix),
        "m_calibrationDepthIntrinsic": _matrix_line(np.asarray(half.K)),
    }
    files["info.txt"] = "".join(f"{key} = {value}\n" for key, value in info.items())
    return write_files(target, files)


def _numbered(scan: WrittenScan, folder: str) -> Files:
    files: Files = {}
    for i, frame in enumerate(scan.frames):
        files[f"{folder}/frame-{i:06d}.color.jpg"] = frame.jpeg
        files[f"{folder}/frame-{i:06d}.depth.png"] = frame.depth_png
        files[f"{folder}/frame-{i:06d}.pose.txt"] = rows_of(frame.scan_from_camera.matrix)
    return files


def _square(K: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = K
    return matrix


def _matrix_line(K: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.9g}" for value in _square(K).ravel())


def scannet(scan: WrittenScan, target: Path) -> Path:
    """Write ScanNet's extracted layout."""
    files: Files = {}
    for i, frame in enumerate(scan.frames):
        files[f"color/{i}.jpg"], files[f"depth/{i}.png"] = frame.jpeg, frame.depth_png
        files[f"pose/{i}.txt"] = rows_of(frame.scan_from_camera.matrix)
    for kind in ("color", "depth"):
        files[f"intrinsic/intrinsic_{kind}.txt"] = rows_of(_square(scan.matrix))
        files[f"intrinsic/extrinsic_{kind}.txt"] = rows_of(np.eye(4))
    return write_files(target, files)


def redwood(scan: WrittenScan, target: Path) -> Path:
    """Write Open3D's layout."""
    files: Files = {}
    lines = []
    for i, frame in enumerate(scan.frames):
        files[f"color/{i:06d}.jpg"], files[f"depth/{i:06d}.png"] = frame.jpeg, frame.depth_png
        lines.append(f"{i} {i} {i + 1}\n{rows_of(frame.scan_from_camera.matrix)}\n")
    files["trajectory.log"] = "".join(lines)
    content = {"width": scan.camera.width, "height": scan.camera.height}
    files["intrinsic.json"] = json.dumps({**content, "intrinsic_matrix": scan.matrix.T.ravel().tolist()})
    return write_files(target, files)


def nerfstudio(scan: WrittenScan, target: Path) -> Path:
    """Write nerfstudio's layout with depth."""
    fx, fy, cx, cy = scan.camera.params[:4]
    files: Files = {}
    frames = []
    for i, frame in enumerate(scan.frames):
        color, depth = f"images/{i:05d}.jpg", f"depth/{i:05d}.png"
        files[color], files[depth] = frame.jpeg, frame.depth_png
        matrix = (frame.scan_from_camera.matrix @ FLIP).tolist()
        frames.append({"file_path": color, "depth_file_path": depth, "transform_matrix": matrix})
    content = {
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx + 0.5,
        "cy": cy + 0.5,
        "w": scan.camera.width,
        "h": scan.camera.height,
    }
    files["transforms.json"] = json.dumps({**content, "frames": frames})
    return write_files(target, files)


def kapture(scan: WrittenScan, target: Path) -> Path:
    """Write kapture's tables, with depth as floats."""
    fx, fy, cx, cy = scan.camera.params[:4]
    params = f"PINHOLE, {scan.camera.width}, {scan.camera.height}, {fx}, {fy}, {cx + 0.5}, {cy + 0.5}"
    files: Files = {
        "sensors/sensors.txt": f"# kapture format: 1.1\ncam, , camera, {params}\ntof, , depth, {params}\n"
    }
    tables: dict[str, list[str]] = {"records_camera": [], "records_depth": [], "trajectories": []}
    for i, frame in enumerate(scan.frames):
        time = round(1e6 * frame.time_s)
        files[f"sensors/records_data/cam/{i:06d}.jpg"] = frame.jpeg
        files[f"sensors/records_data/tof/{i:06d}.depth"] = frame.depth_m.astype("<f4").tobytes()
        tables["records_camera"].append(f"{time}, cam, cam/{i:06d}.jpg")
        tables["records_depth"].append(f"{time}, tof, tof/{i:06d}.depth")
        pose = frame.scan_from_camera.inverse()
        values = ", ".join(f"{v:.12g}" for v in [*pose.quaternion[list(WXYZ)], *pose.translation])
        tables["trajectories"].append(f"{time}, cam, {values}")
    for name, lines in tables.items():
        files[f"sensors/{name}.txt"] = "# kapture format: 1.1\n" + "\n".join(lines) + "\n"
    return write_files(target, files)


def colmap_text(scan: WrittenScan, target: Path) -> Path:
    """Write a COLMAP model as text, with depth images beside it."""
    fx, fy, cx, cy = scan.camera.params[:4]
    size = f"{scan.camera.width} {scan.camera.height}"
    lines = ["# Image list with two lines of data per image:"]
    for i, frame in enumerate(scan.frames):
        pose = frame.scan_from_camera.inverse()
        values = " ".join(f"{v:.12g}" for v in [*pose.quaternion[list(WXYZ)], *pose.translation])
        lines += [f"{i + 1} {values} 1 {i:06d}.jpg", ""]
    files = _colmap_images(scan)
    files["sparse/0/cameras.txt"] = f"1 PINHOLE {size} {fx} {fy} {cx + 0.5} {cy + 0.5}\n"
    files["sparse/0/images.txt"] = "\n".join(lines) + "\n"
    files["sparse/0/points3D.txt"] = ""
    return write_files(target, files)


def colmap_binary(scan: WrittenScan, target: Path) -> Path:
    """Write a COLMAP model as binary files, with depth images beside it."""
    fx, fy, cx, cy = scan.camera.params[:4]
    cameras = struct.pack(
        "<QIiQQ4d", 1, 1, 1, scan.camera.width, scan.camera.height, fx, fy, cx + 0.5, cy + 0.5
    )
    images = struct.pack("<Q", len(scan.frames))
    for i, frame in enumerate(scan.frames):
        pose = frame.scan_from_camera.inverse()
        values = [*pose.quaternion[list(WXYZ)].tolist(), *pose.translation.tolist()]
        images += struct.pack("<I7dI", i + 1, *values, 1) + f"{i:06d}.jpg".encode() + b"\0"
        images += struct.pack("<Q2dq", 1, 1.0, 2.0, -1)
    files = _colmap_images(scan)
    files |= {
        "sparse/0/cameras.bin": cameras,
        "sparse/0/images.bin": images,
        "sparse/0/points3D.bin": bytes(8),
    }
    return write_files(target, files)


def _colmap_images(scan: WrittenScan) -> Files:
    files: Files = {}
    for i, frame in enumerate(scan.frames):
        files[f"images/{i:06d}.jpg"], files[f"depth/{i:06d}.png"] = frame.jpeg, frame.depth_png
    return files


def rtabmap_export(scan: WrittenScan, target: Path) -> Path:
    """Write the folders of rtabmap-export with the poses of the base, whose camera looks along its x."""
    base_from_camera = Pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.1, 0.0, 0.2]))
    files: Files = {}
    lines = ["#timestamp x y z qx qy qz qw id"]
    for i, frame in enumerate(scan.frames, start=1):
        files[f"rtabmap_rgb/{i}.jpg"], files[f"rtabmap_depth/{i}.png"] = frame.jpeg, frame.depth_png
        files[f"rtabmap_calib/{i}.yaml"] = _yaml(scan, base_from_camera)
        base = frame.scan_from_camera @ base_from_camera.inverse()
        lines.append(f"{frame.time_s:.6f} {pose_text(base)} {i}")
    files["rtabmap_poses.txt"] = "\n".join(lines) + "\n"
    return write_files(target, files)


def _yaml(scan: WrittenScan, base_from_camera: Pose) -> str:
    def block(name: str, rows: int, columns: int, values: list[float]) -> str:
        numbers = ", ".join(f"{value:.9g}" for value in values)
        return f"{name}:\n   rows: {rows}\n   cols: {columns}\n   data: [ {numbers} ]\n"

    return (
        f'%YAML:1.0\n---\ncamera_name: "phone"\nimage_width: {scan.camera.width}\nimage_height: {scan.camera.height}\n'
        + block("camera_matrix", 3, 3, scan.matrix.ravel().tolist())
        + block("distortion_coefficients", 1, 5, [0.0] * 5)
        + block("local_transform", 3, 4, base_from_camera.matrix[:3].ravel().tolist())
    )
