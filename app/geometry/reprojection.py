"""Reprojection: the pixels of world points by a pose, their errors and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]
# A camera and its `world_from_camera`, None where it is not known.
View = tuple[Camera, Pose | None]


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


def reprojection_errors_of_views(
    points_px: ArrayLike, points_in_world: ArrayLike, views: Sequence[View]
) -> Array:
    """Return the reprojection errors (k, n) of the same points by each of k views, as `reprojection_errors_px` does by
    one; infinite without a pose."""
    errors = np.full((len(views), len(np.asarray(points_px))), np.inf)
    known = [
        (row, camera, _in_camera(points_in_world, pose))
        for row, (camera, pose) in enumerate(views)
        if pose is not None
    ]
    projected = [camera.project(points) for _, camera, points in known]
    for (row, *_), pixels in zip(known, projected, strict=True):
        offsets = pixels - np.asarray(points_px)
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        errors[row] = np.where(np.isnan(distances), np.inf, distances)
    return errors


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


@dataclass(frozen=True, slots=True, kw_only=True)
class ReprojectionCost:
    """What a pose of a camera costs: the sum over pixels (n, 2) and world points (n, 3) of `weights` (n,) times the
    Cauchy loss of the squared error, whose scale is `scale_px`; with an infinite scale the squared error itself.

    An error counts as `max_error_px` at most, and that of a point that is not in view as much.
    """

    points_px: Array
    points_in_world: Array
    camera: Camera
    weights: Array
    scale_px: float
    max_error_px: float

    def around(self, world_from_camera: Pose) -> tuple[float, Array, Array]:
        """Return the cost of a pose (C eq. 5.1.2).

        After it come the gradient (6,) and the approximate Hessian (6, 6) of half of it by the perturbation of
        `perturbed`.
        """
        projected, jacobian, _ = reprojection_jacobian(self.points_in_world, self.camera, world_from_camera)
        residuals = projected - self.points_px
        distances = np.hypot(residuals[:, 0], residuals[:, 1])
        errors = np.minimum(np.where(np.isnan(distances), np.inf, distances), self.max_error_px)
        seen = np.isfinite(residuals).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        residuals, jacobian = residuals[seen], jacobian[seen]
        # The derivative of the loss by the squared error: the weight in a reweighted least-squares step.
        robust = self.weights[seen] / (1.0 + np.sum(residuals**2, axis=1) / self.scale_px**2)
        weighted = (jacobian * robust[:, None, None]).reshape(-1, 6)
        gradient, hessian = weighted.T @ residuals.reshape(-1), weighted.T @ jacobian.reshape(-1, 6)
        return float(self.weights @ self._losses(errors)), gradient, hessian

    def _losses(self, errors_px: Array) -> Array:
        if np.isinf(self.scale_px):
            return np.asarray(errors_px**2)
        return np.asarray(self.scale_px**2 * np.log1p((errors_px / self.scale_px) ** 2))
