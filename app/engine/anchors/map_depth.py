"""How far away, by a map, what a camera with a known pose sees is."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.geometry.camera import Camera
from app.geometry.se3 import Pose

Array = NDArray[np.float64]

# A map's point is taken to be on a surface that the camera sees when a verified one lies this near in the picture, as
# a share of its width, at a length that differs by no more than this share.
VERIFIED_RADIUS_SHARE, VERIFIED_SPREAD = 0.03, 0.05
# Of points in the same cell, this share of the picture's width, one is kept.
CELL_SHARE = 1.0 / 128.0
# Packed: pixels as shares of the picture's sides, lengths in millimetres, 16 bits each.
STEPS, STEPS_PER_M = 65535, 1000.0
# A pixel takes the length of so many map points around it, no further than this share of the picture's width, and
# only when their lengths agree this well: at the edge of an object they don't.
NEIGHBOURS, RADIUS_SHARE, MAX_SPREAD = 5, 0.02, 0.08


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """A map's points in a camera's picture: pixels (n, 2), and how far along their rays they lie, (n,) in metres."""

    pixels: Array
    lengths_m: Array

    def lengths_at(self, points_px: Array, camera: Camera) -> Array:
        """Return the lengths (m,) in metres along the rays of pixels (m, 2); NaN where the map doesn't tell."""
        out = np.full(len(points_px), np.nan)
        if len(self.pixels) < NEIGHBOURS or len(points_px) == 0:
            return out
        radius = RADIUS_SHARE * camera.width
        distances, rows = cKDTree(self.pixels).query(points_px, k=NEIGHBOURS, distance_upper_bound=radius)
        full = np.isfinite(distances).all(axis=1)
        near = self.lengths_m[np.asarray(rows)[full]]
        middle = np.median(near, axis=1)
        agree = np.ptp(near, axis=1) < MAX_SPREAD * middle
        out[np.flatnonzero(full)[agree]] = middle[agree]
        return out

    def pack(self, camera: Camera) -> str:
        """Return the points as text, to store; those more than 65 m away, which 16 bits don't hold, are left out."""
        shares = (self.pixels + 0.5) / np.array([camera.width, camera.height])
        numbers = np.rint(np.column_stack([shares * STEPS, self.lengths_m * STEPS_PER_M]))
        fit = numbers[:, 2] <= STEPS
        return base64.b64encode(np.clip(numbers[fit], 0, STEPS).astype("<u2").tobytes()).decode()

    @staticmethod
    def unpack(text: str, camera: Camera) -> SeenPoints:
        """Return what `pack` has packed, in pixels of a camera that may have another size."""
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
    """Return how far away what a camera sees is, by a map.

    `verified_in_world` (n, 3) are the map's points that were recognised in the picture, at `verified_px` (n, 2);
    `points_in_world` (m, 3) all points of the keyframes that hold them. Of these only those beside a verified one are
    taken: others may be hidden from the camera, in the next room, behind a wall that the map doesn't hold.
    """
    centre = world_from_camera.translation
    lengths = np.linalg.norm(verified_in_world - centre, axis=1)
    if len(verified_px) == 0:
        return SeenPoints(np.zeros((0, 2)), np.zeros(0))
    pixels = camera.project(world_from_camera.inverse().apply(points_in_world))
    inside = camera.contains(pixels)
    pixels, others = pixels[inside], np.linalg.norm(points_in_world[inside] - centre, axis=1)
    away, nearest = cKDTree(verified_px).query(pixels)
    beside = (away < VERIFIED_RADIUS_SHARE * camera.width) & (
        np.abs(others - lengths[nearest]) < VERIFIED_SPREAD * lengths[nearest]
    )
    pixels = np.concatenate([verified_px, pixels[beside]])
    lengths = np.concatenate([lengths, others[beside]])
    cells = np.floor(pixels / (CELL_SHARE * camera.width)).astype(np.int64)
    _, kept = np.unique(cells, axis=0, return_index=True)
    return SeenPoints(pixels[kept], lengths[kept])
