"""Whether the matches of a picture fit the intrinsics that were stated for it, or others far better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.focal import OPTIONS as FOCAL
from app.geometry.reprojection import PIXEL_NOISE, perturbed, project_from_world, reprojection_jacobian
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class IntrinsicsOptions:
    """How stated intrinsics are compared with those that the matches fit best."""

    steps: int = limit(8, "Largest number of Gauss-Newton steps.", chosen="By hand: it converges in four.")
    min_step: float = limit(1e-5, "A smaller step ends the iteration.", chosen="By hand: far below a pixel.")
    prior_log_focal_sigma: float = limit(
        0.3,
        "Standard deviation of the prior on the logarithm of the focal length.",
        chosen="By hand: a picture that leaves the focal length open keeps the stated one; a zoom of two that matches "
        "determine to a percent is moved by less than that.",
    )
    prior_offset_share: float = limit(
        0.04,
        "Standard deviation of the prior on the principal point's offset, over the longer side of the image.",
        chosen="By hand: more than stabilisation moves it.",
    )


OPTIONS = IntrinsicsOptions()


@dataclass(frozen=True, slots=True)
class FreeIntrinsics:
    """The intrinsics that a picture's matches fit best, as changes of the stated ones.

    `log_focal` is the logarithm of the ratio of focal lengths, `offset_px` (2,) how far the principal point moves;
    `sigmas` (3,) are the standard deviations of the logarithm and of both offsets (pixels), by the matches alone.
    """

    camera: Camera
    pose: Pose
    log_focal: float
    offset_px: Array
    sigmas: Array

    @property
    def focal_sigma(self) -> float:
        """The relative standard deviation of the focal length."""
        return float(self.sigmas[0])


def free_intrinsics(
    points_px: Array, points_in_world: Array, camera: Camera, world_from_camera: Pose
) -> FreeIntrinsics | None:
    """Return the intrinsics that the inliers of a pose fit best: pixels (n, 2), world points (n, 3).

    Gauss-Newton on the Cauchy losses of the reprojection errors over pose, focal length and principal point, from the
    stated camera and its pose; the lens is kept. None where they determine no camera.
    """
    longer = max(camera.width, camera.height)
    prior = np.array(
        [1e-9] * 6 + [OPTIONS.prior_log_focal_sigma**-2] + [(OPTIONS.prior_offset_share * longer) ** -2] * 2
    )
    change, pose, present = np.zeros(3), world_from_camera, camera
    normal = np.eye(9)
    for _ in range(OPTIONS.steps):
        by_all, error = _linearised(points_px, points_in_world, present, pose)
        if len(error) < 9:
            return None
        weights = 1.0 / (1.0 + (np.linalg.norm(error, axis=1) / PIXEL_NOISE.loss_scale_px) ** 2)
        weighted = by_all * np.repeat(FOCAL.match_weight * weights, 2)[:, None]
        from_prior = np.concatenate([np.zeros(6), change])
        normal = weighted.T @ by_all + np.diag(prior)
        try:
            step = -np.linalg.solve(normal, weighted.T @ error.reshape(-1) + prior * from_prior)
            change = change + step[6:]
            pose, present = perturbed(pose, step[:6]), changed_camera(camera, change)
        except (np.linalg.LinAlgError, InvalidCameraError):
            return None
        if np.abs(step[:7]).max() < OPTIONS.min_step:
            break
    covariance = np.linalg.inv(normal)
    return FreeIntrinsics(present, pose, float(change[0]), change[1:], np.sqrt(np.diag(covariance)[6:]))


def _linearised(points_px: Array, points: Array, camera: Camera, pose: Pose) -> tuple[Array, Array]:
    """Return the derivatives (2n, 9) by pose, log focal length and principal point, and errors (n, 2) in pixels."""
    by_pose, _ = reprojection_jacobian(points, camera, pose)
    projected = project_from_world(points, camera, pose)
    seen = np.isfinite(projected).all(axis=1) & np.isfinite(by_pose).all(axis=(1, 2))
    projected, by_pose = projected[seen], by_pose[seen]
    by_focal = projected - camera.principal_point_px
    by_offset = np.broadcast_to(np.eye(2), (len(projected), 2, 2))
    by_all = np.concatenate([by_pose, by_focal[:, :, None], by_offset], axis=2)
    return by_all.reshape(-1, 9), projected - points_px[seen]


def changed_camera(camera: Camera, change: ArrayLike) -> Camera:
    """Return a camera with the logarithm of its focal length and its principal point (pixels) changed by (3,)."""
    change = np.asarray(change, dtype=np.float64)
    fx, fy, cx, cy, *lens = camera.params
    zoom = float(np.exp(change[0]))
    params = (fx * zoom, fy * zoom, cx + float(change[1]), cy + float(change[2]), *lens)
    return Camera(camera.model, camera.width, camera.height, params)
