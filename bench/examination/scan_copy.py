"""A scan copied into a folder in TUM layout, so that it can be changed on the way as people's scans are."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.conventions import PoseArrays
from app.importers.frames import Scan
from app.importers.scan_files import read_text, rows
from app.vision.images import Rgb, decode_image

Array = NDArray[np.float64]
RawDepth = NDArray[np.uint16]
JPEG_QUALITY = 95
# Rows of a trajectory before the first frame and after the last one are kept for this long.
MARGIN_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanCopy:
    """What a copy holds: frames as they are, the rows of its trajectory, its camera, and the options it is read with.

    `picture` and `depth` change images on the way; without them files are copied. `times_s` (n,) and `poses` (n, ...)
    are the trajectory's rows.
    """

    scan: Scan
    times_s: Array
    poses: PoseArrays
    camera: Camera
    depth_scale: float
    gravity: tuple[float, float, float] | None
    picture: Callable[[Rgb], Rgb] | None = None
    depth: Callable[[RawDepth], RawDepth] | None = None
    options: dict[str, Any] = field(default_factory=dict)

    @staticmethod
    def of(
        scan: Scan, gravity: tuple[float, float, float] | None, trajectory: Path | None = None
    ) -> ScanCopy:
        """Return the copy of a scan as it is, with the rows of a `groundtruth.txt` if one is given."""
        times_s, poses = _of_frames(scan) if trajectory is None else _of_file(trajectory, scan)
        return ScanCopy(
            scan=scan,
            times_s=times_s,
            poses=poses,
            camera=scan.camera,
            depth_scale=scan.depth.scale,
            gravity=scan.gravity or gravity,
        )

    def with_row_per_frame(self) -> ScanCopy:
        """Return the copy with one row of the trajectory for each frame."""
        times_s, poses = _of_frames(self.scan)
        return replace(self, times_s=times_s, poses=poses)

    def write(self, folder: Path) -> dict[str, Any]:
        """Write the folder; returns the build options that it is read with."""
        for name in ("rgb", "depth"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        lists: dict[str, list[str]] = {"rgb": [], "depth": []}
        for number, frame in enumerate(self.scan.frames):
            stem = f"{number:04d}"
            lists["rgb"].append(f"{frame.timestamp_s:.6f} {self._color(folder, stem, frame.color)}")
            lists["depth"].append(f"{frame.timestamp_s:.6f} {self._depth(folder, stem, frame.depth)}")
        lists["groundtruth"] = _rows(self.times_s, self.poses)
        for name, lines in lists.items():
            (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
        numbers = " ".join(f"{value:.9g}" for value in self.camera.params)
        (folder / "camera.txt").write_text(
            f"# depth_scale = {self.depth_scale:g}\n"
            f"{self.camera.model} {self.camera.width} {self.camera.height} {numbers}\n"
        )
        if self.gravity is not None:
            (folder / "gravity.txt").write_text(" ".join(f"{value:.9g}" for value in self.gravity) + "\n")
        return {"format": "tum", **self.options}

    def _color(self, folder: Path, stem: str, source: Path) -> str:
        if self.picture is None:
            name = f"rgb/{stem}{source.suffix}"
            shutil.copyfile(source, folder / name)
            return name
        rgb = self.picture(decode_image(source.read_bytes()))
        name = f"rgb/{stem}.jpg"
        cv2.imwrite(str(folder / name), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        return name

    def _depth(self, folder: Path, stem: str, source: Path) -> str:
        name = f"depth/{stem}.png"
        if self.depth is None:
            shutil.copyfile(source, folder / name)
        else:
            raw = np.asarray(cv2.imread(str(source), cv2.IMREAD_UNCHANGED), dtype=np.uint16)
            cv2.imwrite(str(folder / name), self.depth(raw), [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return name


def _of_frames(scan: Scan) -> tuple[Array, PoseArrays]:
    times_s = np.array([frame.timestamp_s for frame in scan.frames])
    return times_s, PoseArrays.of([frame.scan_from_camera for frame in scan.frames])


def _of_file(path: Path, scan: Scan) -> tuple[Array, PoseArrays]:
    values = np.array([[float(cell) for cell in row.cells()[:8]] for row in rows(read_text(path))])
    first, last = scan.frames[0].timestamp_s - MARGIN_S, scan.frames[-1].timestamp_s + MARGIN_S
    values = values[(values[:, 0] >= first) & (values[:, 0] <= last)]
    return values[:, 0], PoseArrays.of([Pose.from_quaternion(row[1:4], row[4:8]) for row in values])


def _rows(times_s: Array, poses: PoseArrays) -> list[str]:
    quaternions = [pose.quaternion for pose in poses.poses()]
    return [
        f"{time_s:.6f} " + " ".join(f"{value:.9f}" for value in (*position, *quaternion))
        for time_s, position, quaternion in zip(times_s, poses.positions, quaternions, strict=True)
    ]
