"""What happens to pictures on their way: less resolution, light or sharpness, things in front, crops, turns.

Each degradation takes a picture (height, width, 3), its camera and a random generator, and returns the picture,
the camera that would have taken it, and how that camera is turned.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.images import Rgb, decode_image

DARK_FACTOR = 0.4
JPEG_QUALITY = 40
BLUR_PX = 15
BRIGHT_FACTOR = 1.9
# Gains of red, green and blue under a warmer light than the camera is set for.
WARM_GAINS = (1.25, 1.0, 0.7)
OTHER_CAMERA_FOCAL_RATIO = 1.15
OTHER_CAMERA_SIZE_RATIO = 0.75
OTHER_CAMERA_K1 = -0.12
OCCLUDED_SHARE = 0.3
CROP_SHARE = 0.7
# Turned clockwise the picture's new x axis is the old -y axis, its new y axis the old x axis.
TURNED_FROM_ORIGINAL = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Degraded:
    """A picture, the intrinsics that hold for it, and `original_from_degraded`, which moves points from its
    camera's frame to that of the camera that took the original: its truth is
    `world_from_camera @ original_from_degraded`."""

    rgb: Rgb
    camera: Camera
    original_from_degraded: Pose = field(default_factory=Pose.identity)


Degradation = Callable[[Rgb, Camera, np.random.Generator], Degraded]


def degrade(name: str, rgb: Rgb, camera: Camera, seed: str) -> Degraded:
    """Apply a degradation of `DEGRADATIONS`; the same name and seed always give the same picture."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), zlib.crc32(seed.encode())])
    return DEGRADATIONS[name](rgb, camera, rng)


def _none(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    return Degraded(rgb, camera)


def _half(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """Half the width and height, averaged."""
    width, height = camera.width // 2, camera.height // 2
    return Degraded(
        _bytes(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)),
        camera.scaled_to(width, height),
    )


def _dark(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """Brightness times 0.4, rounded to whole grey levels as a camera would."""
    return Degraded(_bytes(np.rint(DARK_FACTOR * rgb)), camera)


def _bright(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """Too long an exposure: brightness times 1.9, what is above white is cut off."""
    return Degraded(_bytes(np.minimum(np.rint(BRIGHT_FACTOR * rgb), 255)), camera)


def _warm(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """Another white balance: more red and less blue."""
    return Degraded(_bytes(np.minimum(np.rint(rgb * np.array(WARM_GAINS)), 255)), camera)


def _other_camera(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """The picture of a camera with three quarters of the pixels each way, a longer lens and its distortion."""
    width, height = (round(OTHER_CAMERA_SIZE_RATIO * side) for side in (camera.width, camera.height))
    focal_px = OTHER_CAMERA_FOCAL_RATIO * OTHER_CAMERA_SIZE_RATIO * camera.focal_px
    lens = (OTHER_CAMERA_K1, 0.0, 0.0, 0.0)
    other = Camera("OPENCV", width, height, (focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, *lens))
    v, u = np.mgrid[:height, :width].astype(np.float64)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    source = camera.project(other.unproject(pixels, np.ones(len(pixels)))).astype(np.float32)
    x, y = (source[:, axis].reshape(height, width) for axis in (0, 1))
    return Degraded(_bytes(cv2.remap(rgb, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)), other)


def _jpeg40(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """Through a JPEG file of quality 40."""
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    _written, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return Degraded(decode_image(data.tobytes()), camera)


def _blur(rgb: Rgb, camera: Camera, rng: np.random.Generator) -> Degraded:
    """Linear motion of 15 px in a random direction, centred on the exposure so that no point shifts."""
    kernel = motion_kernel(BLUR_PX, float(rng.uniform(0.0, np.pi)))
    return Degraded(_bytes(cv2.filter2D(rgb, -1, kernel, borderType=cv2.BORDER_REFLECT_101)), camera)


def _occluded(rgb: Rgb, camera: Camera, rng: np.random.Generator) -> Degraded:
    """One rectangle of 30 % of the area, a random shape and place, in one random colour."""
    share_x = np.sqrt(OCCLUDED_SHARE * np.exp(rng.uniform(-np.log(2), np.log(2))))
    width, height = round(share_x * camera.width), round(OCCLUDED_SHARE / share_x * camera.height)
    x, y = _corner(camera, width, height, rng)
    out = rgb.copy()
    out[y : y + height, x : x + width] = rng.integers(0, 256, 3, dtype=np.uint8)
    return Degraded(out, camera)


def _crop70(rgb: Rgb, camera: Camera, rng: np.random.Generator) -> Degraded:
    """70 % of the width and height from a random place; the principal point moves off the middle."""
    width, height = round(CROP_SHARE * camera.width), round(CROP_SHARE * camera.height)
    return _cropped(rgb, camera, *_corner(camera, width, height, rng), width, height)


def _narrow(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """70 % of the width and height from the middle: the picture of a camera with another field of view."""
    width, height = round(CROP_SHARE * camera.width), round(CROP_SHARE * camera.height)
    return _cropped(rgb, camera, (camera.width - width) // 2, (camera.height - height) // 2, width, height)


def _rot90(rgb: Rgb, camera: Camera, _: np.random.Generator) -> Degraded:
    """Turned clockwise by 90 degrees, as from a phone that was held upright and doesn't say so."""
    fx, fy, cx, cy, *lens = camera.params
    if len(lens) >= 4 and camera.model != "OPENCV_FISHEYE":
        # The tangential coefficients are a vector in the image plane, which turns with it.
        lens[2], lens[3] = lens[3], -lens[2]
    turned = Camera(camera.model, camera.height, camera.width, (fy, fx, camera.height - 1 - cy, cx, *lens))
    original_from_degraded = Pose(TURNED_FROM_ORIGINAL.T, np.zeros(3))
    return Degraded(np.ascontiguousarray(np.rot90(rgb, -1)), turned, original_from_degraded)


DEGRADATIONS: dict[str, Degradation] = {
    "none": _none,
    "half": _half,
    "dark": _dark,
    "bright": _bright,
    "warm": _warm,
    "other-camera": _other_camera,
    "jpeg40": _jpeg40,
    "blur": _blur,
    "occluded": _occluded,
    "crop70": _crop70,
    "rot90": _rot90,
    "narrow": _narrow,
}


def motion_kernel(length_px: int, angle_rad: float) -> NDArray[np.float64]:
    """Return the kernel (length + 2, length + 2), of sum 1, of a linear motion through its centre."""
    size = length_px + 2
    kernel = np.zeros((size, size))
    along = np.linspace(-(length_px - 1) / 2, (length_px - 1) / 2, 16 * length_px)
    x, y = size // 2 + along * np.cos(angle_rad), size // 2 + along * np.sin(angle_rad)
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - (x - column)) * np.abs(1 - down - (y - row))
            np.add.at(kernel, (row + down, column + right), weight)
    return np.asarray(kernel / kernel.sum())


def _corner(camera: Camera, width: int, height: int, rng: np.random.Generator) -> tuple[int, int]:
    """Return the upper left pixel of a rectangle at a random place of the picture."""
    return int(rng.integers(camera.width - width + 1)), int(rng.integers(camera.height - height + 1))


def _cropped(rgb: Rgb, camera: Camera, x: int, y: int, width: int, height: int) -> Degraded:
    fx, fy, cx, cy, *lens = camera.params
    crop = Camera(camera.model, width, height, (fx, fy, cx - x, cy - y, *lens))
    return Degraded(np.ascontiguousarray(rgb[y : y + height, x : x + width]), crop)


def _bytes(image: NDArray[np.generic]) -> Rgb:
    return np.ascontiguousarray(image, dtype=np.uint8)
