"""The pose of a rig of least reprojection error near a given one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.pose_refinement import OPTIONS, minimized
from app.geometry.reprojection import PIXEL_NOISE, reprojection_jacobian
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose, perturbed
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertainMotionOptions:
    """The refinement of a rig whose motion is uncertain."""

    steps: int = limit(
        6, "Largest number of Gauss-Newton steps.", chosen="By hand: it starts from a refined pose."
    )


MOTION = UncertainMotionOptions()


def refine_rig_pose(
    views: Sequence[RigView], world_from_rig: Pose, loss_scale_px: float = PIXEL_NOISE.loss_scale_px
) -> Pose:
    """Return the `world_from_rig` of least robust reprojection error (Cauchy loss) near the given one.

    Levenberg-Marquardt over the points of all views, as `refine_pose` does with those of one.
    """
    return minimized(
        world_from_rig, lambda pose: _cost_around(views, pose, loss_scale_px), OPTIONS.refinement_steps
    )


def refine_with_uncertain_motion(
    views: Sequence[RigView],
    world_from_rig: Pose,
    motion_sigmas: Sequence[tuple[float, float]],
    loss_scale_px: float = PIXEL_NOISE.loss_scale_px,
) -> Pose:
    """Return the `world_from_rig` near the given one that fits all views best when their motion is uncertain.

    `motion_sigmas` are, for each view, standard deviations of the error of its position in the rig, in metres, and of
    its rotation, in radians: the lengths of the errors, not their components. Gauss-Newton with an unknown error of
    each view's pose that is eliminated (Schur complement): a view with information H and motion covariance M counts
    with (I + H M)^-1 H, so that a view whose own pose is exact keeps it, whatever less exact motions say.
    """
    pose = world_from_rig
    for _ in range(MOTION.steps):
        gradient, hessian = np.zeros(6), np.zeros((6, 6))
        for view, (position_m, rotation_rad) in zip(views, motion_sigmas, strict=True):
            own_gradient, own_hessian = _view_equations(view, pose @ view.rig_from_camera, loss_scale_px)
            motion = np.repeat([rotation_rad**2 / 3.0, position_m**2 / 3.0], 3)
            certain = np.linalg.inv(np.eye(6) + own_hessian / PIXEL_NOISE.sigma_px**2 * motion)
            camera_by_rig = _camera_by_rig(pose.rotation @ view.rig_from_camera.translation)
            gradient += camera_by_rig.T @ certain @ own_gradient
            hessian += camera_by_rig.T @ certain @ own_hessian @ camera_by_rig
        diagonal = np.diag(hessian)
        step = -np.linalg.solve(hessian + np.diag(1e-9 * diagonal + 1e-300), gradient)
        pose = perturbed(pose, step)
        if float(np.abs(step).max()) < OPTIONS.min_step:
            break
    return pose


def _camera_by_rig(rig_centre_to_camera: Array) -> Array:
    """Return the perturbation (6, 6) of a camera's pose by that of its rig's."""
    return np.asarray(rig_jacobian(np.eye(6)[None], rig_centre_to_camera)[0])


def rig_jacobian(by_camera_pose: Array, rig_centre_to_camera: Array) -> Array:
    """Return derivatives (n, 2, 6) by the pose of a rig from those by the pose of one of its cameras, to which the
    vector (3,) leads from the rig's centre in world axes: a rotation of the rig moves the camera too.

    The six columns are those of `reprojection_jacobian`.
    """
    jacobian = by_camera_pose.copy()
    # d(w x a)/dw: row r by the centre adds a x r to the rotation.
    jacobian[:, :, :3] += np.cross(rig_centre_to_camera, by_camera_pose[:, :, 3:])
    return jacobian


def _cost_around(
    views: Sequence[RigView], world_from_rig: Pose, scale_px: float
) -> tuple[float, Array, Array]:
    cost, gradient, hessian = 0.0, np.zeros(6), np.zeros((6, 6))
    for view in views:
        pose = world_from_rig @ view.rig_from_camera
        camera_by_rig = _camera_by_rig(pose.translation - world_from_rig.translation)
        own_gradient, own_hessian = _view_equations(view, pose, scale_px)
        gradient += camera_by_rig.T @ own_gradient
        hessian += camera_by_rig.T @ own_hessian @ camera_by_rig
        errors = np.minimum(view.errors_px(world_from_rig), OPTIONS.behind_camera_px)
        cost += float(np.sum(scale_px**2 * np.log1p((errors / scale_px) ** 2)))
    return cost, gradient, hessian


def _view_equations(view: RigView, world_from_camera: Pose, scale_px: float) -> tuple[Array, Array]:
    """Return gradient (6,) and approximate Hessian (6, 6) of a view's cost by the pose of its camera."""
    projected, jacobian, _ = reprojection_jacobian(view.points_in_world, view.camera, world_from_camera)
    residuals = projected - view.points_px
    seen = np.isfinite(residuals).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    residuals, jacobian = residuals[seen], jacobian[seen]
    robust = 1.0 / (1.0 + np.sum(residuals**2, axis=1) / scale_px**2)
    weighted = (jacobian * robust[:, None, None]).reshape(-1, 6)
    return weighted.T @ residuals.reshape(-1), weighted.T @ jacobian.reshape(-1, 6)
