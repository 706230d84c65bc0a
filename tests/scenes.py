"""A tiny RGB-D scan made by code: a box room with printed walls, rendered by intersecting rays with planes.

World: z up, metres; the room reaches from (0, 0, 0) to its size. Camera: x right, y down, z forward.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

CAMERA = Camera("PINHOLE", 320, 240, (262.5, 262.5, 159.5, 119.5))
CAMERA_TEXT = ",".join(f"{value:g}" for value in CAMERA.params)
DEPTH_SCALE = 5000.0
SIZE_M = np.array([4.0, 3.0, 2.6])
EYE_HEIGHT_M = 1.4
TEXELS_PER_M = 160


@dataclass(frozen=True)
class View:
    """What a camera of the room sees: colour (h, w, 3), z-depth (h, w) in metres, and where it stands."""

    world_from_camera: Pose
    rgb: Image
    depth_m: Array

    def png(self) -> bytes:
        """Return the colour image as a PNG file."""
        return encode(self.rgb[..., ::-1], ".png")

    def jpeg(self, quality: int = 92) -> bytes:
        """Return the colour image as a JPEG file."""
        return encode(self.rgb[..., ::-1], ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])


@dataclass
class Room:
    """A box room whose six faces are printed at random by `seed`: two seeds share nothing to be found."""

    seed: int = 0
    size_m: Array = field(default_factory=SIZE_M.copy)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        # The face at the low and at the high end of each axis, printed over the other two.
        self._prints = {
            (axis, end): _print(rng, *(self.size_m[i] for i in _others(axis)))
            for axis in range(3)
            for end in (0, 1)
        }

    def view(self, world_from_camera: Pose, camera: Camera = CAMERA) -> View:
        """Render the room from a camera inside it."""
        v, u = np.mgrid[: camera.height, : camera.width]
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        rays = camera.unproject(pixels, np.ones(len(pixels))) @ world_from_camera.rotation.T
        start = world_from_camera.translation
        with np.errstate(divide="ignore"):
            ahead = np.where(rays > 0, self.size_m - start, -start) / rays
        ahead[~np.isfinite(ahead)] = np.inf
        axes, depth_m = ahead.argmin(axis=1), ahead.min(axis=1)
        points = start + depth_m[:, None] * rays
        rgb = np.zeros((len(rays), 3), np.uint8)
        for (axis, end), texture in self._prints.items():
            hit = (axes == axis) & ((rays[:, axis] > 0) == bool(end))
            rgb[hit] = _sampled(texture, points[hit][:, list(_others(axis))])
        shape = camera.height, camera.width
        return View(world_from_camera, rgb.reshape(*shape, 3), depth_m.reshape(shape))


def pose_at(
    x: float, y: float, z: float = EYE_HEIGHT_M, yaw_deg: float = 0.0, pitch_deg: float = 0.0
) -> Pose:
    """Return `world_from_camera` of an upright camera; yaw counter-clockwise from world x, pitch upwards."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    return Pose(np.stack([right, np.cross(forward, right), forward], axis=1), np.array([x, y, z]))


def walk(count: int = 14) -> list[Pose]:
    """Return the scan's poses: a step along the room, looking from one long wall round to the other."""
    return [
        pose_at(1.4 + 0.08 * i, 1.3 + 0.04 * i, EYE_HEIGHT_M + 0.02 * (i % 3), -40 + 9.0 * i, -3.0 + (i % 4))
        for i in range(count)
    ]


def query_poses() -> list[Pose]:
    """Return poses between those of the scan, none of them in it."""
    return [
        pose_at(1.4 + 0.08 * i + 0.06, 1.3 + 0.04 * i - 0.05, EYE_HEIGHT_M + 0.03, -40 + 9.0 * i + 4.0, 1.0)
        for i in (1, 4, 7, 10)
    ]


def scan_files(views: Sequence[View], scan_from_world: Pose | None = None) -> dict[str, bytes]:
    """Return the files of a scan in TUM layout, its poses in the frame that `scan_from_world` leads to."""
    files: dict[str, bytes] = {}
    rgb, depth, truth = (
        ["# timestamp filename"],
        ["# timestamp filename"],
        ["# timestamp tx ty tz qx qy qz qw"],
    )
    for i, view in enumerate(views):
        time = f"{i / 10:.6f}"
        raw = np.rint(view.depth_m * DEPTH_SCALE).astype(np.uint16)
        files[f"rgb/{time}.png"], files[f"depth/{time}.png"] = view.png(), encode(raw, ".png")
        rgb.append(f"{time} rgb/{time}.png")
        depth.append(f"{time} depth/{time}.png")
        pose = view.world_from_camera if scan_from_world is None else scan_from_world @ view.world_from_camera
        numbers = " ".join(f"{value:.9f}" for value in (*pose.translation, *pose.quaternion))
        truth.append(f"{time} {numbers}")
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", truth)):
        files[f"{name}.txt"] = ("\n".join(lines) + "\n").encode()
    return files


def zipped(files: Mapping[str, bytes]) -> bytes:
    """Return a zip of files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            # Without the present time: the same files make the same archive.
            member = zipfile.ZipInfo(name)
            member.compress_type = zipfile.ZIP_DEFLATED
            member.external_attr = 0o600 << 16
            archive.writestr(member, data)
    return buffer.getvalue()


def encode(image: NDArray[np.uint8] | NDArray[np.uint16], suffix: str, options: Sequence[int] = ()) -> bytes:
    """Return an image file of OpenCV's BGR or grey pixels."""
    written, data = cv2.imencode(suffix, image, options)
    assert written
    return data.tobytes()


def _others(axis: int) -> tuple[int, int]:
    a, b = (i for i in range(3) if i != axis)
    return a, b


def _print(rng: np.random.Generator, width_m: float, height_m: float) -> Image:
    """Return a picture that corner and blob detectors like: patches of all sizes over soft noise."""
    width, height = int(width_m * TEXELS_PER_M), int(height_m * TEXELS_PER_M)
    noise = rng.normal(size=(height // 8 + 1, width // 8 + 1, 3))
    picture = 128 + 30 * cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(int(60 * width_m * height_m)):
        x, y = rng.uniform([0, 0], [width, height])
        w, h = np.exp(rng.uniform(np.log(3), np.log(30), 2))
        color = rng.uniform(0, 255, 3)
        corners = cv2.boxPoints(((x, y), (w, h), rng.uniform(0, 90)))
        cv2.fillConvexPoly(picture, corners.astype(np.int32), color.tolist())
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 1.0), 0, 255).astype(np.uint8)


def _sampled(texture: Image, points_m: Array) -> Image:
    if len(points_m) == 0:
        return np.zeros((0, 3), np.uint8)
    at = (points_m * TEXELS_PER_M - 0.5).astype(np.float32)
    # OpenCV's remap takes at most 32767 rows: a square grid of the points instead of one column.
    side = int(np.ceil(np.sqrt(len(at))))
    grid = np.zeros((side * side, 2), np.float32)
    grid[: len(at)] = at
    grid = grid.reshape(side, side, 2)
    out = cv2.remap(texture, grid, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return out.reshape(-1, 3)[: len(at)]
