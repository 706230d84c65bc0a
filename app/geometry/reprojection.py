"""Reprojection: the pixels of world points by a pose, their errors and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelNoiseOptions:
    """The noise of a matched feature's pixel, for all estimators that minimize reprojection errors."""

    sigma_px: float = limit(
        1.0,
        "Standard deviation of the pixel of a matched feature.",
        chosen="By hand: descriptor matches have a pixel or two of noise.",
    )
    loss_scale_px: float = limit(
        2.0,
        "Reprojection error at which a match's weight falls to half (Cauchy loss).",
        chosen="By hand: twice the noise of a good feature.",
    )


PIXEL_NOISE = PixelNoiseOptions()


def project_from_world(points_in_world: ArrayLike, camera: Camera, world_from_camera: Pose) -> Array:
    """Return the pixels (n, 2) of world points (n, 3); NaN where not in view (A eq. 10, C eq. 5.1.1)."""
    return camera.project(_in_camera(points_in_world, world_from_camera))


def _in_camera(points_in_world: ArrayLike, world_from_camera: Pose) -> Array:
    points = np.asarray(points_in_world, dtype=np.float64)
    return np.asarray((points - world_from_camera.translation) @ world_from_camera.rotation)


def reprojection_errors_px(
    points_px: ArrayLike, points_in_world: ArrayLike, camera: Camera, world_from_camera: Pose
) -> Array:
    """Return the distances (n,) in pixels of points (n, 2) from the projections of world points (n, 3).

    The error of a point that is not in view is infinite. These are the norms in the sums of A eq. 11 and C eq.
    5.1.2.
    """
    offsets = project_from_world(points_in_world, camera, world_from_camera) - np.asarray(points_px)
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    return np.asarray(np.where(np.isnan(distances), np.inf, distances))


def agreeing_points(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    world_from_camera: Pose,
    max_error_px: float,
) -> tuple[NDArray[np.bool_], float]:
    """Return which world points (n, 3) are projected within `max_error_px` of their pixels (n, 2), and the root mean
    square of the errors of these in pixels, NaN without any."""
    errors_px = reprojection_errors_px(points_px, points_in_world, camera, world_from_camera)
    agree = errors_px <= max_error_px
    rms_px = float(np.sqrt(np.mean(errors_px[agree] ** 2))) if agree.any() else float("nan")
    return agree, rms_px


def reprojection_jacobian(
    points_in_world: ArrayLike, camera: Camera, world_from_camera: Pose
) -> tuple[Array, Array, Array]:
    """Return the pixels of points (n, 3), and their derivatives by the pose (n, 2, 6) and by the points (n, 2, 3).

    The six columns are the perturbation that `perturbed` applies: a rotation vector in world axes (px/rad),
    then the camera centre in world metres (px/m). NaN for points not in view.
    """
    points = np.asarray(points_in_world, dtype=np.float64)
    pixels, by_camera_point = camera.projection_jacobian(_in_camera(points, world_from_camera))
    by_world_point = by_camera_point @ world_from_camera.rotation.T
    # d(exp(-w) v)/dw = skew(v): row k of `by_world_point` times skew(v) is their cross product.
    from_centre = points - world_from_camera.translation
    by_rotation = np.cross(by_world_point, from_centre[:, None, :])
    return pixels, np.concatenate([by_rotation, -by_world_point], axis=2), by_world_point


def perturbed(world_from_camera: Pose, step: ArrayLike) -> Pose:
    """Return the pose rotated about its centre by step[:3] (rad, world axes) and moved by step[3:] (m)."""
    delta = np.asarray(step, dtype=np.float64)
    rotation = rotation_from_vector(delta[:3]) @ world_from_camera.rotation
    return Pose(rotation, world_from_camera.translation + delta[3:])
