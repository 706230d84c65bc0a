"""Where a posed camera should see world points, and how that moves with the pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector

Array = NDArray[np.float64]


def project_from_world(points_in_world: ArrayLike, camera: Camera, world_from_camera: Pose) -> Array:
    """Return the pixels (n, 2) of world points (n, 3); NaN if not in view (A eq. 10, C eq. 5.1.1)."""
    return camera.project(world_from_camera.inverse().apply(points_in_world))


def reprojection_errors_px(
    points_px: ArrayLike, points_in_world: ArrayLike, camera: Camera, world_from_camera: Pose
) -> Array:
    """Return the distances (n,) in pixels of points (n, 2) from the projections of world points (n, 3).

    A point that is not in front of the camera is infinitely far. This is the norm under A eq. 11 and C eq.
    5.1.2.
    """
    offsets = project_from_world(points_in_world, camera, world_from_camera) - np.asarray(points_px)
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    return np.asarray(np.where(np.isnan(distances), np.inf, distances))


def reprojection_jacobian(
    points_in_world: ArrayLike, camera: Camera, world_from_camera: Pose
) -> tuple[Array, Array]:
    """Return how the pixels of points (n, 3) move with the pose (n, 2, 6) and the points (n, 2, 3).

    The six columns are the perturbation that `perturbed` applies: a rotation vector in world axes (px/rad),
    then the camera centre in world metres (px/m). NaN for points not in front of the camera.
    """
    points = np.asarray(points_in_world, dtype=np.float64)
    camera_from_world = world_from_camera.inverse()
    by_camera_point = camera.projection_jacobian(camera_from_world.apply(points))
    by_world_point = by_camera_point @ camera_from_world.rotation
    # d(exp(-w) v)/dw = skew(v): row k of `by_world_point` times skew(v) is their cross product.
    from_centre = points - world_from_camera.translation
    by_rotation = np.cross(by_world_point, from_centre[:, None, :])
    return np.concatenate([by_rotation, -by_world_point], axis=2), by_world_point


def perturbed(world_from_camera: Pose, step: ArrayLike) -> Pose:
    """Return the pose turned about its centre by step[:3] (rad, world axes), moved by step[3:] (m)."""
    delta = np.asarray(step, dtype=np.float64)
    rotation = rotation_from_vector(delta[:3]) @ world_from_camera.rotation
    return Pose(rotation, world_from_camera.translation + delta[3:])
