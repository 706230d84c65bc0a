"""The pose of several cameras that move together, from the points that they see, and its covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.covariance import camera_terms, covariance_of_terms
from app.geometry.estimators.chosen import ESTIMATORS
from app.geometry.estimators.interface import MIN_POINTS, RansacBudget
from app.geometry.pnp import OPTIONS
from app.geometry.reprojection import PIXEL_NOISE
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs

Array = NDArray[np.float64]


def estimate_rig_pose(views: Sequence[RigView], max_error_tangent: float, max_iterations: int) -> Pose | None:
    """Return the `world_from_rig` with which most points of all views agree, None for fewer than four of them.

    Generalized LO-RANSAC by `ESTIMATORS`, then a robust refinement. `max_error_tangent` is the inlier limit: the
    reprojection error over the focal length. Raises `InvalidInputError` for numbers that are not finite.
    """
    count = 0
    for view in views:
        count += len(finite_pairs(view.points_px, 2, "pixels", view.points_in_world, 3, "world points")[0])
    if count < MIN_POINTS:
        return None
    budget = RansacBudget(
        max_error_px=max_error_tangent * views[0].camera.focal_px,
        max_iterations=max_iterations,
        min_iterations=min(OPTIONS.min_lo_ransac_iterations, max_iterations),
        seed=0,
    )
    return ESTIMATORS.rig_pose(views, budget, loss_scale_px=PIXEL_NOISE.loss_scale_px)


def rig_covariance(
    views: Sequence[RigView],
    world_from_rig: Pose,
    point_sigmas_m: Sequence[Array],
    *,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
) -> Array:
    """Return the covariance (6, 6) of a rig's pose that fits the points of all views by least squares.

    Order, units and raised errors as `pose_covariance`; the pose is the one of the rig's own frame. Focal length and
    lens are one unknown each for all views. The motion between the views counts as exact.
    """
    terms = []
    for view, sigma_m in zip(views, point_sigmas_m, strict=True):
        pose = world_from_rig @ view.rig_from_camera
        term = camera_terms(view.points_px, view.points_in_world, view.camera, pose, sigma_m)
        terms.append(term.moved(pose.translation - world_from_rig.translation))
    if sum(len(term.jacobian) for term in terms) < MIN_POINTS:
        raise DegenerateGeometryError("A pose covariance needs at least four points in front of the cameras.")
    return covariance_of_terms(terms, focal_sigma=focal_sigma, lens_sigma=lens_sigma)
