"""The frames that are written: pictures, depth and poses in memory, and how they change for a format."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose, rotation_between
from app.importers.frames import Scan
from app.vision.images import decode_image

JPEG_QUALITY = 97
# The size of the depth images of phones with LiDAR.
PHONE_DEPTH = (256, 192)


@dataclass(frozen=True, slots=True)
class WrittenFrame:
    """A frame: time, picture (height, width, 3) as BGR, depth (h, w) in metres, pose `scan_from_camera`."""

    time_s: float
    bgr: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    scan_from_camera: Pose

    @property
    def jpeg(self) -> bytes:
        """The picture as a JPEG file."""
        return cv2.imencode(".jpg", self.bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()

    @property
    def depth_mm(self) -> NDArray[np.uint16]:
        """The depth in millimetres."""
        return (1000.0 * self.depth_m).round().astype(np.uint16)

    @property
    def depth_png(self) -> bytes:
        """The depth in millimetres as a PNG file."""
        return cv2.imencode(".png", self.depth_mm)[1].tobytes()


@dataclass(frozen=True, slots=True)
class WrittenScan:
    """Frames of one camera (a pinhole) and the direction of down in the frame of their poses."""

    camera: Camera
    frames: tuple[WrittenFrame, ...]
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def moved(self, moved_from_scan: Pose) -> WrittenScan:
        """Return the scan with its poses in another frame."""
        x, y, z = (moved_from_scan.rotation @ np.array(self.down)).tolist()
        frames = (replace(f, scan_from_camera=moved_from_scan @ f.scan_from_camera) for f in self.frames)
        return WrittenScan(self.camera, tuple(frames), (x, y, z))

    def turned_to(self, down: tuple[float, float, float]) -> Pose:
        """Return the rotation to a frame in which down is as given."""
        return Pose(rotation_between(self.down, down), np.zeros(3))

    def with_depth_of(self, width: int, height: int) -> WrittenScan:
        """Return the scan with depth images of another size, of the same field of view."""
        smaller = self.camera.scaled_to(width, height)
        v, u = np.mgrid[:height, :width]
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        ratio = self.camera.width / smaller.width
        places = (pixels + 0.5) * ratio - 0.5
        frames = (
            replace(f, depth_m=sample_depth(f.depth_m, places).reshape(height, width)) for f in self.frames
        )
        return WrittenScan(self.camera, tuple(frames), self.down)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The camera's 3x3 matrix."""
        return np.asarray(self.camera.K, dtype=np.float64)


# Writes a scan below a folder and returns what is sent: a folder or a file.
Writer = Callable[[WrittenScan, Path], Path]
# Ends the names of formats that are written without depth.
WITHOUT_DEPTH = ", no depth"


def without_depth(write: Writer, *depth_files: str) -> Writer:
    """Return the writer that leaves out files and folders of depth."""

    def written(scan: WrittenScan, target: Path) -> Path:
        folder = write(scan, target)
        for path in (folder / name for name in depth_files):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        return folder

    return written


def written_scan(scan: Scan, down: tuple[float, float, float]) -> WrittenScan:
    """Return all frames of a scan in memory, with the centre of its camera and without a lens."""
    frames = tuple(
        WrittenFrame(
            frame.timestamp_s,
            cv2.cvtColor(decode_image(scan.color_bytes(frame)), cv2.COLOR_RGB2BGR).astype(np.uint8),
            scan.depth_m(frame),
            frame.scan_from_camera,
        )
        for frame in scan.frames
    )
    return WrittenScan(scan.camera, frames, down)


def rows_of(matrix: NDArray[np.float64]) -> str:
    """Return a matrix as text, a line a row."""
    return "\n".join(" ".join(f"{value:.9g}" for value in row) for row in matrix)


def write_files(folder: Path, contents: dict[str, bytes | str]) -> Path:
    """Write files below a folder and return it."""
    for name, data in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    return folder


def pose_text(pose: Pose, order: Sequence[int] = (0, 1, 2, 3)) -> str:
    """Return `x y z` and the quaternion, x y z w in the given order."""
    quaternion = pose.quaternion[list(order)]
    return " ".join(f"{value:.9g}" for value in [*pose.translation, *quaternion])
