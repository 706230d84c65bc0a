"""How far away things are by the floor plan alone: on the floor, on a wall, or on the ceiling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.walls import FloorWalls
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthOptions:
    """How far away things are taken to be."""

    room_height_m: float = limit(2.9, "Height of a ceiling.", chosen="By hand: a usual room.")
    max_distance_m: float = limit(
        15.0, "Nothing is taken to be farther away.", chosen="By hand: a long room."
    )
    min_distance_m: float = limit(0.4, "Nothing is taken to be nearer.", chosen="By hand: an arm.")
    step_m: float = limit(
        0.15, "Step of the search for a wall.", chosen="By hand: less than a wall's thickness."
    )


OPTIONS = DepthOptions()


def distances_by_plan(
    pixels: Array, camera: Camera, frame_from_camera: Pose, ground_m: float, walls: FloorWalls | None
) -> Array:
    """Return the distances (n,) along the rays of pixels (n, 2) to floor, ceiling or wall, whichever is nearest, in
    metres; `ground_m` is the height of the floor in the frame of the pose."""
    rays = homogeneous(camera.normalize(pixels)) @ frame_from_camera.rotation.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    eye = frame_from_camera.translation
    height_m = max(eye[2] - ground_m, 0.5)
    up = rays[:, 2]
    distances = np.full(len(rays), OPTIONS.max_distance_m)
    down, above = up < -1e-3, up > 1e-3
    distances[down] = np.minimum(distances[down], height_m / -up[down])
    distances[above] = np.minimum(distances[above], max(OPTIONS.room_height_m - height_m, 0.5) / up[above])
    if walls is not None:
        distances = np.minimum(distances, _to_walls(rays, eye[:2], walls))
    return np.asarray(np.clip(distances, OPTIONS.min_distance_m, OPTIONS.max_distance_m))


def _to_walls(rays: Array, at: Array, walls: FloorWalls) -> Array:
    """Return the distances (n,) along rays (n, 3) to the first cell of another area that is no door."""
    flat = np.maximum(np.linalg.norm(rays[:, :2], axis=1), 1e-6)
    steps = np.arange(OPTIONS.step_m, OPTIONS.max_distance_m, OPTIONS.step_m)
    points = at + steps[:, None, None] * (rays[:, :2] / flat[:, None])
    labels, doors = walls.at(points.reshape(-1, 2))
    labels, doors = labels.reshape(points.shape[:2]), doors.reshape(points.shape[:2])
    own = walls.labels(at[None])[0]
    before = np.concatenate([np.full((1, len(rays)), own), labels[:-1]])
    is_wall = (labels != before) & ~doors
    first = np.where(is_wall.any(axis=0), is_wall.argmax(axis=0), len(steps) - 1)
    return np.asarray(steps[first] / flat)
