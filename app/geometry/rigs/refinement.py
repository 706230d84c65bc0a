"""The pose of a rig of least reprojection error near a given one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.geometry.pose_refinement import OPTIONS, minimized
from app.geometry.reprojection import PIXEL_NOISE, reprojection_jacobian
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose

Array = NDArray[np.float64]


def refine_rig_pose(
    views: Sequence[RigView], world_from_rig: Pose, loss_scale_px: float = PIXEL_NOISE.loss_scale_px
) -> Pose:
    """Return the `world_from_rig` of least robust reprojection error (Cauchy loss) near the given one.

    Levenberg-Marquardt over the points of all views, as `refine_pose` does with those of one.
    """
    return minimized(
        world_from_rig,
        lambda pose: sum(_cost(view, pose, loss_scale_px) for view in views),
        lambda pose: _normal_equations(views, pose, loss_scale_px),
        OPTIONS.refinement_steps,
    )


def rig_jacobian(by_camera_pose: Array, rig_centre_to_camera: Array) -> Array:
    """Return derivatives (n, 2, 6) by the pose of a rig from those by the pose of one of its cameras, to which the
    vector (3,) leads from the rig's centre in world axes: a rotation of the rig moves the camera too.

    The six columns are those of `reprojection_jacobian`.
    """
    jacobian = by_camera_pose.copy()
    # d(w x a)/dw: row r by the centre adds a x r to the rotation.
    jacobian[:, :, :3] += np.cross(rig_centre_to_camera, by_camera_pose[:, :, 3:])
    return jacobian


def _cost(view: RigView, world_from_rig: Pose, scale_px: float) -> float:
    errors = np.minimum(view.errors_px(world_from_rig), OPTIONS.behind_camera_px)
    return float(np.sum(scale_px**2 * np.log1p((errors / scale_px) ** 2)))


def _normal_equations(views: Sequence[RigView], world_from_rig: Pose, scale_px: float) -> tuple[Array, Array]:
    gradient, hessian = np.zeros(6), np.zeros((6, 6))
    for view in views:
        pose = world_from_rig @ view.rig_from_camera
        projected, by_camera, _ = reprojection_jacobian(view.points_in_world, view.camera, pose)
        residuals = projected - view.points_px
        seen = np.isfinite(residuals).all(axis=1) & np.isfinite(by_camera).all(axis=(1, 2))
        residuals = residuals[seen]
        jacobian = rig_jacobian(by_camera[seen], pose.translation - world_from_rig.translation)
        robust = 1.0 / (1.0 + np.sum(residuals**2, axis=1) / scale_px**2)
        weighted = (jacobian * robust[:, None, None]).reshape(-1, 6)
        gradient += weighted.T @ residuals.reshape(-1)
        hessian += weighted.T @ jacobian.reshape(-1, 6)
    return gradient, hessian
