"""Distances of what a camera with a known pose sees, by the points of a map."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]

# Packed points are three 16-bit numbers: u and v in steps of the image's width and height, and the length.
STEPS = 65535
STEPS_PER_M = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MapDepthOptions:
    """Which of a map's points a camera is taken to see, and which of them give a pixel its length."""

    verified_radius_ratio: float = limit(
        0.03,
        "Largest distance of a map point from the nearest verified point, divided by the image's width.",
        chosen="By hand: both then lie on one surface, which the camera sees.",
    )
    verified_length_ratio: float = limit(
        0.05,
        "Largest difference of the lengths of a map point and of that verified point, divided by the latter's.",
        chosen="By hand: both then lie on one surface, which the camera sees.",
    )
    cell_ratio: float = limit(
        1.0 / 128.0,
        "Side of the grid cells in which one point is kept, divided by the image's width.",
        chosen="By hand; no measurement is recorded.",
    )
    neighbours: int = limit(
        5,
        "Number of the nearest map points whose median length a pixel gets.",
        chosen="By hand; no measurement is recorded.",
    )
    neighbour_radius_ratio: float = limit(
        0.02,
        "Largest distance of these points from the pixel, divided by the image's width.",
        chosen="By hand; no measurement is recorded.",
    )
    max_length_range_ratio: float = limit(
        0.08,
        "Largest range of their lengths, divided by the median.",
        chosen="By hand: at the edge of an object the lengths differ by more.",
    )


OPTIONS = MapDepthOptions()


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """A map's points in a camera's image: pixels (n, 2) and lengths (n,) along their rays in metres."""

    pixels: Array
    lengths_m: Array

    def lengths_at(self, points_px: Array, camera: Camera) -> Array:
        """Return the lengths (m,) in metres along the rays of pixels (m, 2); NaN where the map doesn't know them."""
        out = np.full(len(points_px), np.nan)
        if len(self.pixels) < OPTIONS.neighbours or len(points_px) == 0:
            return out
        radius_px = OPTIONS.neighbour_radius_ratio * camera.width
        distances, rows = cKDTree(self.pixels).query(
            points_px, k=OPTIONS.neighbours, distance_upper_bound=radius_px
        )
        full = np.isfinite(distances).all(axis=1)
        near = self.lengths_m[np.asarray(rows)[full]]
        middle = np.median(near, axis=1)
        agree = np.ptp(near, axis=1) < OPTIONS.max_length_range_ratio * middle
        out[np.flatnonzero(full)[agree]] = middle[agree]
        return out

    def pack(self, camera: Camera) -> str:
        """Return the points as text to store; points more than 65 m away don't fit into 16 bits and are left out."""
        shares = (self.pixels + 0.5) / np.array([camera.width, camera.height])
        numbers = np.rint(np.column_stack([shares * STEPS, self.lengths_m * STEPS_PER_M]))
        fit = numbers[:, 2] <= STEPS
        return base64.b64encode(np.clip(numbers[fit], 0, STEPS).astype("<u2").tobytes()).decode()

    @staticmethod
    def unpack(text: str, camera: Camera) -> SeenPoints:
        """Return the points that `pack` packed, in pixels of a camera whose image size may differ."""
        numbers = np.frombuffer(base64.b64decode(text), dtype="<u2").reshape(-1, 3).astype(np.float64)
        pixels = numbers[:, :2] / STEPS * np.array([camera.width, camera.height]) - 0.5
        return SeenPoints(pixels, numbers[:, 2] / STEPS_PER_M)


def points_seen(
    camera: Camera,
    world_from_camera: Pose,
    verified_px: Array,
    verified_in_world: Array,
    points_in_world: Array,
) -> SeenPoints:
    """Return the points of a map that a camera sees.

    `verified_in_world` (n, 3) are the map points that were matched with the image, at `verified_px` (n, 2);
    `points_in_world` (m, 3) are all points of the keyframes that hold them. Of these only the points near a verified
    one are taken. Others may be hidden from the camera, in the next room behind a wall that the map doesn't have.
    """
    centre = world_from_camera.translation
    lengths = np.linalg.norm(verified_in_world - centre, axis=1)
    if len(verified_px) == 0:
        return SeenPoints(np.zeros((0, 2)), np.zeros(0))
    pixels = camera.project(world_from_camera.inverse().apply(points_in_world))
    inside = camera.contains(pixels)
    pixels, others = pixels[inside], np.linalg.norm(points_in_world[inside] - centre, axis=1)
    distances_px, nearest = cKDTree(verified_px).query(pixels)
    beside = (distances_px < OPTIONS.verified_radius_ratio * camera.width) & (
        np.abs(others - lengths[nearest]) < OPTIONS.verified_length_ratio * lengths[nearest]
    )
    pixels = np.concatenate([verified_px, pixels[beside]])
    lengths = np.concatenate([lengths, others[beside]])
    cells = np.floor(pixels / (OPTIONS.cell_ratio * camera.width)).astype(np.int64)
    _, kept = np.unique(cells, axis=0, return_index=True)
    return SeenPoints(pixels[kept], lengths[kept])
