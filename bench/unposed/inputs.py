"""What is sent: frames of a scan as a video, as photos, and with depth but no poses; and a distance in one frame."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.depth import sample_depth
from app.importers.frames import Frame, Scan
from app.vision.images import decode_image
from bench.formats.frames import write_files

Array = NDArray[np.float64]
FPS = 15.0
CODEC = "mp4v"
# A distance that somebody would measure is between two corners on even surfaces.
CORNERS = 100
CORNER_QUALITY = 0.03
CORNER_DISTANCE_PX = 15
BORDER_PX = 40
PATCH_PX = 6
MAX_DEPTH_RANGE = 0.03
MAX_DEPTH_M = 2.5


@dataclass(frozen=True, slots=True)
class MeasuredDistance:
    """The metres between two pixels (2, 2) of a frame of the video, by the sensor's depth."""

    number: int
    pixels: Array
    distance_m: float

    @property
    def option(self) -> dict[str, Any]:
        """The option `scale` that states it."""
        return {
            "distance_m": round(self.distance_m, 4),
            "frame": self.number / FPS,
            "pixels": self.pixels.round(2).tolist(),
        }


def write_video(scan: Scan, target: Path) -> Path:
    """Write the frames of a scan as a plain mp4 and return it."""
    size = scan.camera.width, scan.camera.height
    writer = cv2.VideoWriter(str(target), cv2.VideoWriter.fourcc(*CODEC), FPS, size)
    for frame in scan.frames:
        writer.write(cv2.cvtColor(decode_image(scan.color_bytes(frame)), cv2.COLOR_RGB2BGR))
    writer.release()
    return target


def write_photos(scan: Scan, every: int, folder: Path) -> Path:
    """Write every n-th frame of a scan as a photo, named by its number, and return the folder."""
    return write_files(
        folder,
        {
            f"{number:06d}{frame.color.suffix}": scan.color_bytes(frame)
            for number, frame in enumerate(scan.frames)
            if number % every == 0
        },
    )


def write_depth_frames(scan: Scan, folder: Path) -> Path:
    """Write a scan in TUM layout with depth and without a trajectory, and return the folder."""
    rows: dict[str, list[str]] = {"rgb": [], "depth": []}
    for frame in scan.frames:
        for kind, source in (("rgb", frame.color), ("depth", frame.depth)):
            name = f"{kind}/{frame.timestamp_s:.6f}{source.suffix}"
            (folder / kind).mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, folder / name)
            rows[kind].append(f"{frame.timestamp_s:.6f} {name}")
    return write_files(folder, {f"{kind}.txt": "\n".join(lines) + "\n" for kind, lines in rows.items()})


def measured_distance(scan: Scan, number: int) -> MeasuredDistance:
    """Return the longest distance in a frame between two corners on even surfaces near the camera."""
    frame = scan.frames[number]
    corners = _corners(scan, frame)
    depth_m = sample_depth(scan.depth_m(frame), corners)
    points = scan.camera.unproject(corners, depth_m)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    first, second = np.unravel_index(int(apart.argmax()), apart.shape)
    return MeasuredDistance(number, corners[[first, second]], float(apart[first, second]))


def _corners(scan: Scan, frame: Frame) -> Array:
    gray = cv2.cvtColor(decode_image(scan.color_bytes(frame)), cv2.COLOR_RGB2GRAY)
    inside = gray[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    found = cv2.goodFeaturesToTrack(inside, CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX)
    corners = np.asarray(found, dtype=np.float64).reshape(-1, 2) + BORDER_PX
    depth_m = scan.depth_m(frame)

    def is_even(pixel: Array) -> bool:
        u, v = pixel.astype(int)
        patch = depth_m[v - PATCH_PX : v + PATCH_PX + 1, u - PATCH_PX : u + PATCH_PX + 1]
        middle = float(np.median(patch))
        return bool((patch > 0).all() and np.ptp(patch) < MAX_DEPTH_RANGE * middle and middle < MAX_DEPTH_M)

    return np.array([corner for corner in corners if is_even(corner)])
