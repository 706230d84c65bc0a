"""One synthetic scene for all geometry tests: cameras of every model, posed in a world of known points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose, project_to_so3, rotation_from_vector

Array = NDArray[np.float64]

CAMERAS = {
    "PINHOLE": Camera("PINHOLE", 640, 480, (525.0, 520.0, 318.0, 241.5)),
    "OPENCV": Camera("OPENCV", 640, 480, (525.0, 520.0, 318.0, 241.5, -0.2, 0.05, 0.001, -0.0007)),
    "FULL_OPENCV": Camera(
        "FULL_OPENCV",
        640,
        480,
        (525.0, 520.0, 318.0, 241.5, 0.1, 0.02, 0.001, -0.0007, 0.005, 0.15, 0.01, 0.002),
    ),
    "OPENCV_FISHEYE": Camera(
        "OPENCV_FISHEYE", 640, 480, (330.0, 328.0, 318.0, 241.5, -0.02, 0.005, 0.001, -0.0005)
    ),
}
MODELS = tuple(CAMERAS)


@dataclass(frozen=True)
class Scene:
    """A posed camera, the pixels it saw, the world points they show, and which of the pairs are true."""

    camera: Camera
    world_from_camera: Pose
    points_px: Array
    points_in_world: Array
    is_true: NDArray[np.bool_]


@dataclass(frozen=True)
class TwoViews:
    """Two posed cameras, their pixels of the same points, and the points in the first camera's frame."""

    camera_a: Camera
    camera_b: Camera
    b_from_a: Pose
    points_a_px: Array
    points_b_px: Array
    points_in_a: Array
    is_true: NDArray[np.bool_]


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a rotation (3, 3), uniform enough over all of SO(3)."""
    return project_to_so3(rng.normal(size=(3, 3)))


def random_pose(rng: np.random.Generator, spread_m: float = 3.0) -> Pose:
    """Return a pose turned any way, with its origin within a few times `spread_m`."""
    return Pose(random_rotation(rng), rng.normal(size=3) * spread_m)


def random_pixels(rng: np.random.Generator, camera: Camera, n: int) -> Array:
    """Return pixels (n, 2) all over the picture."""
    return rng.uniform([0.0, 0.0], [camera.width - 1.0, camera.height - 1.0], (n, 2))


def make_scene(
    rng: np.random.Generator,
    *,
    model: str = "PINHOLE",
    n: int = 200,
    noise_px: float = 0.0,
    outlier_ratio: float = 0.0,
    planar: bool = False,
) -> Scene:
    """Return a scene of n points 1 to 5 m before the camera, some of the pixels replaced by random ones."""
    camera, world_from_camera = CAMERAS[model], random_pose(rng)
    pixels = random_pixels(rng, camera, n)
    depth_m = rng.uniform(1.0, 5.0, n)
    if planar:
        # A plane tilted against the picture: its inverse depth is affine in the image plane.
        depth_m = 1.0 / (0.4 + camera.normalize(pixels) @ [0.1, 0.15])
    points_in_world = world_from_camera.apply(camera.unproject(pixels, depth_m))
    is_true = rng.permutation(n) >= round(outlier_ratio * n)
    seen = pixels + rng.normal(size=(n, 2)) * noise_px
    seen[~is_true] = random_pixels(rng, camera, int((~is_true).sum()))
    return Scene(camera, world_from_camera, seen, points_in_world, is_true)


def make_two_views(
    rng: np.random.Generator,
    *,
    models: tuple[str, str] = ("PINHOLE", "PINHOLE"),
    n: int = 200,
    noise_px: float = 0.0,
    outlier_ratio: float = 0.0,
    baseline_m: float = 1.0,
) -> TwoViews:
    """Return n matches of two cameras `baseline_m` apart that look at the same points, some of them wrong."""
    camera_a, camera_b = CAMERAS[models[0]], CAMERAS[models[1]]
    turn = rotation_from_vector(rng.normal(size=3) * 0.1)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.3]
    b_from_a = Pose(turn, direction / np.linalg.norm(direction) * baseline_m)
    kept_a, kept_b, kept_points = np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 3))
    while len(kept_a) < n:
        a_px = random_pixels(rng, camera_a, 4 * n)
        points = camera_a.unproject(a_px, rng.uniform(2.0, 6.0, 4 * n))
        b_px = camera_b.project(b_from_a.apply(points))
        visible = camera_b.contains(b_px)
        kept_a, kept_b = np.vstack([kept_a, a_px[visible]]), np.vstack([kept_b, b_px[visible]])
        kept_points = np.vstack([kept_points, points[visible]])
    is_true = rng.permutation(n) >= round(outlier_ratio * n)
    a, b = (kept[:n] + rng.normal(size=(n, 2)) * noise_px for kept in (kept_a, kept_b))
    b[~is_true] = random_pixels(rng, camera_b, int((~is_true).sum()))
    return TwoViews(camera_a, camera_b, b_from_a, a, b, kept_points[:n], is_true)
