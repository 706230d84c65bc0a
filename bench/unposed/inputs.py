"""What is sent: frames of a scan as a video, as photos, and with depth but no poses; and a distance in one frame."""

from __future__ import annotations

import io
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from app.engine.query.camera_sources import FILM_DIAGONAL_MM
from app.geometry.alignment import world_from_scan_by_gravity
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.importers.frames import Frame, Scan
from app.vision.exif import EXIF_IFD, FOCAL_35MM
from app.vision.images import Rgb, decode_image
from bench.formats.frames import write_files

Array = NDArray[np.float64]
FPS = 15.0
CODEC = "mp4v"
JPEG_QUALITY = 92
# Plan places are stated to a centimetre, at this number of photos.
PLACES = 5
PLACE_DIGITS = 2
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
        return self.in_frame(self.number / FPS)

    def in_frame(self, frame: float | str) -> dict[str, Any]:
        """Return the option `scale` that states it of a second of a video, or of a photo's name."""
        return {
            "distance_m": round(self.distance_m, 4),
            "frame": frame,
            "pixels": self.pixels.round(2).tolist(),
        }


def write_video(scan: Scan, target: Path, fps: float = FPS) -> Path:
    """Write the frames of a scan as a plain mp4 and return it."""
    size = scan.camera.width, scan.camera.height
    writer = cv2.VideoWriter(str(target), cv2.VideoWriter.fourcc(*CODEC), fps, size)
    for frame in scan.frames:
        writer.write(cv2.cvtColor(decode_image(scan.color_bytes(frame)), cv2.COLOR_RGB2BGR))
    writer.release()
    return target


def write_photos(scan: Scan, every: int, folder: Path) -> Path:
    """Write every n-th frame of a scan as a JPEG, named by its number, and return the folder.

    As phones do, a photo states its focal length as the equivalent on 35 mm film, in whole millimetres.
    """
    exif = _exif(scan.camera)
    return write_files(
        folder,
        {
            photo_name(number): _jpeg(decode_image(scan.color_bytes(frame)), exif)
            for number, frame in enumerate(scan.frames)
            if number % every == 0
        },
    )


def photo_name(number: int) -> str:
    """Return the name of the photo of a frame."""
    return f"{number:06d}.jpg"


def _exif(camera: Camera) -> Image.Exif:
    exif = Image.Exif()
    diagonal_px = np.hypot(camera.width, camera.height)
    exif[EXIF_IFD] = {FOCAL_35MM: round(float(camera.focal_px / diagonal_px * FILM_DIAGONAL_MM))}
    return exif


def _jpeg(rgb: Rgb, exif: Image.Exif) -> bytes:
    data = io.BytesIO()
    Image.fromarray(rgb).save(data, "JPEG", quality=JPEG_QUALITY, exif=exif)
    return data.getvalue()


def plan_places(scan: Scan, every: int, down: Array) -> dict[str, Any]:
    """Return the option `scale` that states where the camera stood at some of the photos, on a plan below them.

    The photos are those furthest from each other, one after the other; `down` (3,) is in the frame of the poses.
    """
    upright = world_from_scan_by_gravity(down)
    numbers = list(range(0, len(scan.frames), every))
    stood = np.array(
        [upright.apply(scan.frames[k].scan_from_camera.translation[None])[0, :2] for k in numbers]
    )
    chosen = [0]
    while len(chosen) < min(PLACES, len(numbers)):
        apart = np.linalg.norm(stood[:, None] - stood[chosen], axis=2).min(axis=1)
        chosen.append(int(apart.argmax()))
    return {
        "correspondences": [
            {"frame": photo_name(numbers[row]), "plan": stood[row].round(PLACE_DIGITS).tolist()}
            for row in chosen
        ]
    }


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
