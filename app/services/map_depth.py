"""How far away, by a map, what a camera with a known pose sees is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.storage.map_artifact import MapArtifact

Array = NDArray[np.float64]

# Keyframes further away, or looking elsewhere, show little of what the camera sees.
MAX_DISTANCE_M, MIN_COSINE, MAX_KEYFRAMES = 8.0, 0.3, 80
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


def points_seen(artifact: MapArtifact, camera: Camera, world_from_camera: Pose) -> SeenPoints:
    """Return the map's points that lie in a camera's picture, of the keyframes that look the same way nearby."""
    arrays = artifact.arrays
    distances = np.linalg.norm(arrays.positions - world_from_camera.translation, axis=1)
    axes = np.stack([artifact.pose(i).rotation[:, 2] for i in range(artifact.keyframe_count)])
    cosines = axes @ world_from_camera.rotation[:, 2]
    usable = np.flatnonzero((distances < MAX_DISTANCE_M) & (cosines > MIN_COSINE))
    chosen = usable[np.argsort(distances[usable])][:MAX_KEYFRAMES]
    if len(chosen) == 0:
        return SeenPoints(np.zeros((0, 2)), np.zeros(0))
    points = np.concatenate([arrays.points_in_world[artifact.rows(int(row))] for row in chosen]).astype(
        np.float64
    )
    in_camera = world_from_camera.inverse().apply(points)
    pixels = camera.project(in_camera)
    inside = camera.contains(pixels)
    return SeenPoints(pixels[inside], np.linalg.norm(in_camera[inside], axis=1))
