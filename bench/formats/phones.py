"""Scans as phones' apps write them."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import lzfse
import numpy as np

from app.geometry.se3 import Pose, vector_from_rotation
from bench.formats.frames import PHONE_DEPTH, Writer, WrittenScan, pose_text, rows_of, write_files

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
ARKIT_DOWN = (0.0, -1.0, 0.0)
HIGH_CONFIDENCE = 2


def as_arkit(write: Writer) -> Writer:
    """Return the writer that turns the scan's world to y up and its depth to a phone's size first."""

    def turned(scan: WrittenScan, target: Path) -> Path:
        return write(scan.moved(scan.turned_to(ARKIT_DOWN)).with_depth_of(*PHONE_DEPTH), target)

    return turned


def confidence_png(
    depth_mm: np.ndarray[tuple[int, ...], np.dtype[np.uint16]], high: int = HIGH_CONFIDENCE
) -> bytes:
    """Return a confidence image: high where there is depth, low elsewhere."""
    return cv2.imencode(".png", np.where(depth_mm > 0, high, 0).astype(np.uint8))[1].tobytes()


@as_arkit
def stray_scanner(scan: WrittenScan, target: Path) -> Path:
    """Write `rgb.mp4`, `odometry.csv` and so on."""
    target.mkdir(parents=True, exist_ok=True)
    write_video(scan, target / "rgb.mp4")
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    files: dict[str, bytes | str] = {}
    for i, frame in enumerate(scan.frames):
        lines.append(f"{frame.time_s:.6f}, {i:06d}, {pose_text(frame.scan_from_camera).replace(' ', ', ')}")
        files[f"depth/{i:06d}.png"] = frame.depth_png
        files[f"confidence/{i:06d}.png"] = confidence_png(frame.depth_mm)
    files["odometry.csv"] = "\n".join(lines) + "\n"
    files["camera_matrix.csv"] = rows_of(scan.matrix).replace(" ", ", ") + "\n"
    return write_files(target, files)


def write_video(scan: WrittenScan, path: Path, fps: float = 30.0) -> Path:
    """Write the scan's pictures as a video."""
    size = scan.camera.width, scan.camera.height
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
    for frame in scan.frames:
        writer.write(frame.bgr)
    writer.release()
    return path


def record3d(pack: Callable[[bytes], bytes]) -> Writer:
    """Return the writer of a `.r3d` file whose depth is packed by a function."""

    @as_arkit
    def write(scan: WrittenScan, target: Path) -> Path:
        target.parent.mkdir(parents=True, exist_ok=True)
        path = target.with_suffix(".r3d")
        width, height = PHONE_DEPTH
        start_s = scan.frames[0].time_s
        metadata = {
            "w": scan.camera.width,
            "h": scan.camera.height,
            "dw": width,
            "dh": height,
            "fps": 30,
            "K": scan.matrix.T.ravel().tolist(),
            "poses": [_record3d_pose(frame.scan_from_camera) for frame in scan.frames],
            "frameTimestamps": [frame.time_s - start_s for frame in scan.frames],
        }
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            archive.writestr("metadata", json.dumps(metadata))
            for i, frame in enumerate(scan.frames):
                archive.writestr(f"rgbd/{i}.jpg", frame.jpeg)
                archive.writestr(f"rgbd/{i}.depth", pack(frame.depth_m.astype("<f4").tobytes()))
                confidence = np.where(frame.depth_m > 0, HIGH_CONFIDENCE, 0).astype(np.uint8)
                archive.writestr(f"rgbd/{i}.conf", pack(confidence.tobytes()))
        return path

    return write


def _record3d_pose(pose: Pose) -> list[float]:
    flipped = Pose.from_matrix(pose.matrix @ FLIP)
    return [*flipped.quaternion.tolist(), *flipped.translation.tolist()]


record3d_lzfse = record3d(lambda data: bytes(lzfse.compress(data)))
record3d_plain = record3d(lambda data: data)


@as_arkit
def scanner_app(scan: WrittenScan, target: Path) -> Path:
    """Write the files of 3D Scanner App's "all data"."""
    files: dict[str, bytes | str] = {"info.json": json.dumps({"title": "scan"})}
    for i, frame in enumerate(scan.frames):
        files[f"frame_{i:05d}.jpg"] = frame.jpeg
        files[f"depth_{i:05d}.png"] = frame.depth_png
        files[f"conf_{i:05d}.png"] = confidence_png(frame.depth_mm)
        files[f"frame_{i:05d}.json"] = json.dumps(
            {
                "time": frame.time_s,
                "cameraPoseARFrame": (frame.scan_from_camera.matrix @ FLIP).ravel().tolist(),
                "intrinsics": scan.matrix.ravel().tolist(),
            }
        )
    return write_files(target, files)


@as_arkit
def polycam(scan: WrittenScan, target: Path) -> Path:
    """Write Polycam's raw export."""
    files: dict[str, bytes | str] = {}
    fx, fy, cx, cy = scan.camera.params[:4]
    for frame in scan.frames:
        stem = str(round(1e6 * frame.time_s))
        matrix = frame.scan_from_camera.matrix @ FLIP
        entry = {
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "width": scan.camera.width,
            "height": scan.camera.height,
        }
        entry |= {f"t_{r}{c}": float(matrix[r, c]) for r in range(3) for c in range(4)}
        files[f"keyframes/images/{stem}.jpg"] = frame.jpeg
        files[f"keyframes/depth/{stem}.png"] = frame.depth_png
        files[f"keyframes/confidence/{stem}.png"] = confidence_png(frame.depth_mm, 255)
        files[f"keyframes/cameras/{stem}.json"] = json.dumps({**entry, "timestamp": int(stem)})
    return write_files(target, files)


def arkit_scenes(scan: WrittenScan, target: Path) -> Path:
    """Write a recording of ARKitScenes, whose world has z up."""
    scan = scan.moved(scan.turned_to((0.0, 0.0, -1.0))).with_depth_of(*PHONE_DEPTH)
    fx, fy, cx, cy = scan.camera.params[:4]
    files: dict[str, bytes | str] = {}
    lines = []
    for frame in scan.frames:
        stem = f"41069021_{frame.time_s:.3f}"
        pose = frame.scan_from_camera.inverse()
        values = [float(f"{frame.time_s:.3f}"), *vector_from_rotation(pose.rotation), *pose.translation]
        lines.append(" ".join(f"{value:.12g}" for value in values))
        files[f"lowres_wide/{stem}.jpg"] = frame.jpeg
        files[f"lowres_depth/{stem}.png"] = frame.depth_png
        files[f"confidence/{stem}.png"] = confidence_png(frame.depth_mm)
        camera = f"{scan.camera.width} {scan.camera.height} {fx} {fy} {cx} {cy}"
        files[f"lowres_wide_intrinsics/{stem}.pincam"] = camera
    files["lowres_wide.traj"] = "\n".join(lines) + "\n"
    return write_files(target, files)
