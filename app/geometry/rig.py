"""The pose of several cameras that move together (a rig, or the frames of a burst with known motion)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import poselib
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import camera_terms, covariance_of_terms
from app.geometry.pnp import MIN_POINTS, OPTIONS, bundle_options, poselib_camera, poselib_pose
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class RigView:
    """What one camera of a rig sees: pixels (n, 2) of world points (n, 3), its camera, and where it is in the rig."""

    points_px: Array
    points_in_world: Array
    camera: Camera
    rig_from_camera: Pose

    def errors_px(self, world_from_rig: Pose) -> Array:
        """Return the reprojection errors (n,) of the points with the rig at a pose."""
        pose = world_from_rig @ self.rig_from_camera
        return reprojection_errors_px(self.points_px, self.points_in_world, self.camera, pose)

    def take(self, mask: Mask) -> RigView:
        """Return the view with the points that the mask (n,) marks."""
        return RigView(self.points_px[mask], self.points_in_world[mask], self.camera, self.rig_from_camera)


def estimate_rig_pose(
    views: Sequence[RigView], max_errors_px: Sequence[float], max_iterations: int, loss_scale_px: float
) -> Pose | None:
    """Return the `world_from_rig` with which most points of all views agree, None for fewer than four of them.

    Generalized LO-RANSAC with samples of three points from any views, then a robust refinement of the rig's pose.
    `max_errors_px` are the inlier limits of the views: since the estimator takes one for all, pixels are compared at
    the resolution of the first view. Raises `InvalidInputError` for numbers that are not finite. Source: Kukelova et
    al., "Efficient Intersection of Three Quadrics and Applications in Computer Vision" (gp3p), as in PoseLib.
    """
    pairs = [finite_pairs(view.points_px, 2, "pixels", view.points_in_world, 3, "points") for view in views]
    if sum(len(pixels) for pixels, _ in pairs) < MIN_POINTS:
        return None
    scales = [max_errors_px[0] / limit_px for limit_px in max_errors_px]
    ransac = {
        "max_reproj_error": max_errors_px[0],
        "max_iterations": max_iterations,
        "min_iterations": min(OPTIONS.min_lo_ransac_iterations, max_iterations),
        "seed": 0,
    }
    found, info = poselib.estimate_generalized_absolute_pose(
        [_scaled_px(pixels, scale) for (pixels, _), scale in zip(pairs, scales, strict=True)],
        [points for _, points in pairs],
        [poselib_pose(view.rig_from_camera) for view in views],
        [_scaled_camera(view.camera, scale) for view, scale in zip(views, scales, strict=True)],
        ransac,
        bundle_options(loss_scale_px),
    )
    if info["num_inliers"] < MIN_POINTS:
        return None
    return Pose(found.R, found.t).inverse()


def refine_rig_pose(views: Sequence[RigView], world_from_rig: Pose, loss_scale_px: float) -> Pose:
    """Return the `world_from_rig` of least robust reprojection error (Cauchy loss) near the given one.

    The points of the views must be inliers, at least `MIN_POINTS` of them.
    """
    found, _ = poselib.refine_generalized_absolute_pose(
        [view.points_px for view in views],
        [view.points_in_world for view in views],
        poselib_pose(world_from_rig),
        [poselib_pose(view.rig_from_camera) for view in views],
        [poselib_camera(view.camera) for view in views],
        bundle_options(loss_scale_px),
    )
    return Pose(found.R, found.t).inverse()


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
        terms.append(term.moved(world_from_rig.rotation @ view.rig_from_camera.translation))
    if sum(len(term.jacobian) for term in terms) < MIN_POINTS:
        raise DegenerateGeometryError("A pose covariance needs at least four points in front of the cameras.")
    return covariance_of_terms(terms, focal_sigma=focal_sigma, lens_sigma=lens_sigma)


def _scaled_px(pixels: Array, scale: float) -> Array:
    return np.asarray((pixels + 0.5) * scale - 0.5)


def _scaled_camera(camera: Camera, scale: float) -> poselib.Camera:
    fx, fy, cx, cy = camera.params[:4]
    centre_px = _scaled_px(np.array([cx, cy]), scale)
    params = (fx * scale, fy * scale, *centre_px, *camera.params[4:])
    return poselib.Camera(camera.model, params, round(camera.width * scale), round(camera.height * scale))
