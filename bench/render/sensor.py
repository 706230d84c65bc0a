"""What a real sensor makes of a perfect picture: light noise, vignetting, blur, and a depth camera's
errors."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera

Floats = NDArray[np.float32]
Colours = NDArray[np.uint8]

DEPTH_SCALE = 1000.0
JPEG_QUALITY = 90
# Sigma of depth from structured light: floor + growth (z - nearest)^2, in metres (Nguyen et al., 2012).
NOISE_FLOOR_M = 0.0012
NOISE_GROWTH = 0.0019
NOISE_NEAREST_M = 0.4
# Nothing nearer gives depth.
NEAREST_M = 0.35
# From here on fewer and fewer pixels have depth.
FADE_START_M = 6.0
# Nothing farther away gives depth.
FARTHEST_M = 8.0
GRAZING_COSINE = 0.17
EDGE_JUMP = 0.04


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourSensor:
    """A colour camera: noise deviations in grey levels, corner darkening 0 to 1, exposure factor, blur in
    pixels, and factors of red, green and blue where the white balance doesn't suit the light."""

    read_noise: float = 1.0
    shot_noise: float = 0.14
    vignetting: float = 0.16
    exposure: float = 1.0
    blur_px: float = 0.0
    blur_angle_deg: float = 0.0
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)


def colour_picture(rng: np.random.Generator, rgb: Colours, camera: Camera, sensor: ColourSensor) -> Colours:
    """Return the picture (h, w, 3) a sensor makes of exact colours (h, w, 3)."""
    image = rgb.astype(np.float32)
    if sensor.blur_px > 0.5:
        image = np.asarray(
            cv2.filter2D(image, -1, _streak(sensor.blur_px, sensor.blur_angle_deg)), np.float32
        )
    image *= sensor.exposure * _vignette(camera, sensor.vignetting)[..., None]
    image *= np.array(sensor.gains, np.float32)
    deviation = np.sqrt(sensor.read_noise**2 + sensor.shot_noise**2 * np.maximum(image, 0))
    image += deviation * rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(np.clip(image + 0.5, 0, 255), dtype=np.uint8)


def _vignette(camera: Camera, strength: float) -> Floats:
    _, _, cx, cy = camera.params[:4]
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    squared = ((x - cx) ** 2 + (y - cy) ** 2) / (cx * cx + cy * cy)
    return np.asarray(1 - strength * squared**1.5, dtype=np.float32)


def _streak(length_px: float, angle_deg: float) -> Floats:
    """Return a line-shaped kernel that sums to 1."""
    size = 2 * int(np.ceil(length_px / 2)) + 3
    kernel = np.zeros((size, size), np.float32)
    middle = size // 2
    half = length_px / 2 * np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    ends = np.round((middle + np.stack([-half, half])) * 16).astype(int)
    cv2.line(kernel, tuple(ends[0].tolist()), tuple(ends[1].tolist()), 1.0, 1, cv2.LINE_AA, 4)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def depth_sigma_m(depth_m: Floats) -> Floats:
    """Return the standard deviation of measured depth, metres."""
    return np.asarray(NOISE_FLOOR_M + NOISE_GROWTH * (depth_m - NOISE_NEAREST_M) ** 2, dtype=np.float32)


def depth_picture(rng: np.random.Generator, depth_m: Floats, camera: Camera) -> NDArray[np.uint16]:
    """Return measured depth (h, w) in 1/1000 m from exact depth (h, w) in metres; 0 where there is no
    return."""
    noisy = depth_m + depth_sigma_m(depth_m) * rng.standard_normal(depth_m.shape, dtype=np.float32)
    fade = (depth_m - FADE_START_M) / (FARTHEST_M - FADE_START_M)
    lost = rng.random(depth_m.shape, dtype=np.float32) < fade
    lost |= (depth_m < NEAREST_M) | _at_edge(depth_m) | _grazing(depth_m, camera)
    noisy[lost] = 0
    return np.clip(noisy * DEPTH_SCALE + 0.5, 0, 65534).astype(np.uint16)


def _at_edge(depth_m: Floats) -> NDArray[np.bool_]:
    kernel = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(depth_m, kernel) > (1 + EDGE_JUMP) * cv2.erode(depth_m, kernel) + 0.02)


def _grazing(depth_m: Floats, camera: Camera) -> NDArray[np.bool_]:
    """Return which surfaces are seen so obliquely that no light comes back; the normal is that of inverse
    depth."""
    fx, fy, cx, cy = camera.params[:4]
    inverse = 1 / np.maximum(depth_m, 1e-3)
    nx = fx * cv2.Sobel(inverse, cv2.CV_32F, 1, 0, scale=1 / 8)
    ny = fy * cv2.Sobel(inverse, cv2.CV_32F, 0, 1, scale=1 / 8)
    x = ((np.arange(camera.width, dtype=np.float32) - cx) / fx)[None, :]
    y = ((np.arange(camera.height, dtype=np.float32) - cy) / fy)[:, None]
    # 1/z = n.(x, y, 1) on a plane, so n = (nx, ny, 1/z - nx x - ny y), and n.ray = 1/z.
    nz = inverse - nx * x - ny * y
    length = np.sqrt(nx * nx + ny * ny + nz * nz) * np.sqrt(1 + x * x + y * y)
    return np.asarray(inverse < GRAZING_COSINE * length)
