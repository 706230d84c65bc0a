"""The pose of a camera from pixels and the world points that they show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
import poselib
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.camera import Camera
from app.geometry.epnp import MIN_EPNP_POINTS, solve_epnp
from app.geometry.reprojection import (
    PIXEL_NOISE,
    perturbed,
    reprojection_errors_px,
    reprojection_jacobian,
)
from app.geometry.se3 import Pose, quaternion_from_rotation
from app.geometry.validation import finite_pairs
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Loss = Literal["cauchy", "trivial"]

# Any three points fit a pose exactly: only a fourth one confirms it.
MIN_POINTS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PnpOptions:
    """Inlier limits and budgets of the estimators, unless a caller gives others, and the refinement's steps."""

    max_error_px: float = limit(
        8.0,
        "Largest reprojection error of an inlier.",
        chosen="By hand: the same as OpenCV's default for PnP.",
    )
    lo_ransac_iterations: int = limit(
        5000,
        "Largest number of samples of LO-RANSAC.",
        chosen="By hand: bounds the time when most matches are wrong.",
    )
    min_lo_ransac_iterations: int = limit(
        100,
        "Least number of samples of LO-RANSAC.",
        chosen="By hand: a few good samples are compared even when the first one fits well.",
    )
    epnp_iterations: int = limit(
        1000,
        "Largest number of RANSAC samples before EPnP.",
        chosen="By hand: bounds the time when most matches are wrong.",
    )
    confidence: float = limit(
        0.999,
        "RANSAC ends when a sample without outliers was drawn with this probability.",
        chosen="By hand: one failure in a thousand by chance.",
    )
    poselib_steps: int = limit(
        50,
        "Largest number of steps of PoseLib's own refinement.",
        chosen="By hand: meant to be enough to converge.",
    )
    refinement_steps: int = limit(
        30,
        "Largest number of Levenberg-Marquardt steps, rejected ones included.",
        chosen="By hand: meant to be enough to converge.",
    )
    behind_camera_px: float = limit(
        1e4,
        "Residual of a point behind the camera.",
        chosen="By hand: more than any reprojection error, and finite so that the costs of steps can be compared.",
    )
    min_step: float = limit(
        1e-8,
        "The refinement ends when a step is smaller than this, in metres and radians.",
        chosen="By hand: far below the error of a pose.",
    )
    min_gain_ratio: float = limit(
        1e-10,
        "The refinement ends when a step lowers the cost by at most this ratio.",
        chosen="By hand: near the rounding error.",
    )
    initial_damping: float = limit(
        1e-4,
        "Damping of the first step, relative to the diagonal of the normal equations.",
        chosen="By hand: nearly a Gauss-Newton step.",
    )
    min_damping: float = limit(
        1e-10,
        "Lower bound of the damping.",
        chosen="By hand: no damping, up to rounding.",
    )
    max_damping: float = limit(
        1e8,
        "The refinement ends when no step up to this damping lowers the cost.",
        chosen="By hand: such a step moves nothing.",
    )


OPTIONS = PnpOptions()


@dataclass(frozen=True, slots=True)
class PnpEstimate:
    """A camera's pose and the correspondences that agree with it.

    `inlier_mask` (n,) marks the reprojection errors within the limit at this pose; `reprojection_rms_px` is
    over the inliers; `iterations` is the number of RANSAC samples, 0 when the estimator doesn't report it.
    """

    world_from_camera: Pose
    inlier_mask: Mask
    reprojection_rms_px: float
    iterations: int


def estimate_pose_lo_ransac(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    *,
    max_error_px: float = OPTIONS.max_error_px,
    max_iterations: int = OPTIONS.lo_ransac_iterations,
    min_iterations: int = OPTIONS.min_lo_ransac_iterations,
    loss_scale_px: float = PIXEL_NOISE.loss_scale_px,
    seed: int = 0,
    prior: Pose | None = None,
    sorted_by_quality: bool = False,
) -> PnpEstimate | None:
    """Return the pose with the most inliers among pixels (n, 2) and world points (n, 3), or None if there is none.

    Locally optimized RANSAC with three-point samples, then a robust refinement on all inliers. `prior` is a
    `world_from_camera` to start from. With `sorted_by_quality` the matches are sorted, best first, and samples are
    drawn from the best first (PROSAC). The same input and seed give the same answer. None for fewer than four points
    or four inliers.
    Raises `InvalidInputError` for numbers that are not finite. Source: LO-RANSAC as in PoseLib; minimizes C
    eq. 5.1.2.
    """
    view, bundle = poselib_camera(camera), bundle_options(loss_scale_px)
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    if len(pixels) < MIN_POINTS:
        return None
    ransac = {
        "max_reproj_error": max_error_px,
        "max_iterations": max_iterations,
        "min_iterations": min(min_iterations, max_iterations),
        "progressive_sampling": sorted_by_quality,
        "seed": seed,
    }
    start = None if prior is None else poselib_pose(prior)
    found, info = poselib.estimate_absolute_pose(pixels, points, view, ransac, bundle, start)
    if info["num_inliers"] < MIN_POINTS:
        return None
    pose = Pose(found.R, found.t).inverse()
    return _estimate(pixels, points, camera, pose, max_error_px, int(info["iterations"]))


def _estimate(
    pixels: Array, points: Array, camera: Camera, pose: Pose, max_error_px: float, iterations: int
) -> PnpEstimate | None:
    errors = reprojection_errors_px(pixels, points, camera, pose)
    inliers = errors <= max_error_px
    if np.count_nonzero(inliers) < MIN_POINTS:
        return None
    return PnpEstimate(pose, inliers, float(np.sqrt(np.mean(errors[inliers] ** 2))), iterations)


def estimate_pose_epnp_lm(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    *,
    max_error_px: float = OPTIONS.max_error_px,
    max_iterations: int = OPTIONS.epnp_iterations,
    confidence: float = OPTIONS.confidence,
    seed: int = 0,
) -> PnpEstimate | None:
    """Return the pose with the most inliers among pixels (n, 2) and world points (n, 3), or None if there is none.

    RANSAC finds the inliers, EPnP gives a pose from all of them, and Levenberg-Marquardt minimizes the squared
    reprojection error. The same input and seed give the same answer. None for fewer than five points or inliers;
    raises as `estimate_pose_lo_ransac`. Source: A eq. 11; C eq. 5.1.2 is the same sum.
    """
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    inliers = _ransac_inliers(pixels, points, camera, max_error_px, max_iterations, confidence, seed)
    if len(inliers) < MIN_EPNP_POINTS:
        return None
    try:
        rough = solve_epnp(pixels[inliers], points[inliers], camera)
        pose = refine_pose(pixels[inliers], points[inliers], camera, rough, loss="trivial")
    except DegenerateGeometryError:
        return None
    return _estimate(pixels, points, camera, pose, max_error_px, 0)


def _ransac_inliers(
    pixels: Array,
    points: Array,
    camera: Camera,
    max_error_px: float,
    max_iterations: int,
    confidence: float,
    seed: int,
) -> NDArray[np.intp]:
    none = np.empty(0, dtype=np.intp)
    if len(pixels) < MIN_EPNP_POINTS:
        return none
    seen, distortion = _opencv_view(pixels, camera)
    cv2.setRNGSeed(seed)
    try:
        # P3P takes four-point samples; EPnP's five-point ones are slower and fail for points on one plane.
        ok, _, _, index = cv2.solvePnPRansac(
            points,
            seen,
            camera.K,
            distortion,
            iterationsCount=max_iterations,
            reprojectionError=max_error_px,
            confidence=confidence,
            flags=cv2.SOLVEPNP_P3P,
        )
    except cv2.error:  # Raised for sets of points that no pose fits.
        return none
    return np.asarray(index[:, 0], dtype=np.intp) if ok and index is not None else none


def refine_pose(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    world_from_camera: Pose,
    *,
    loss: Loss = "cauchy",
    loss_scale_px: float = PIXEL_NOISE.loss_scale_px,
    weights: ArrayLike | None = None,
    max_steps: int = OPTIONS.refinement_steps,
) -> Pose:
    """Return the `world_from_camera` of least reprojection error near the given one.

    Minimizes the sum over pixels (n, 2) and world points (n, 3) of `weights` (n,) times the loss of the squared
    error: 'trivial' is the squared error itself (A eq. 11, C eq. 5.1.2), 'cauchy' grows only logarithmically beyond
    `loss_scale_px`. Levenberg-Marquardt with the analytic Jacobian. Raises `DegenerateGeometryError` for fewer than
    three points in front of the camera, `InvalidInputError` for numbers that are not finite or weights below zero.
    """
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    factors = _checked_weights(weights, len(pixels))
    errors = reprojection_errors_px(pixels, points, camera, world_from_camera)
    if np.count_nonzero(np.isfinite(errors) & (factors > 0)) < 3:
        raise DegenerateGeometryError("A pose needs at least three points in front of the camera.")
    scale_px = loss_scale_px if loss == "cauchy" else np.inf
    return _levenberg_marquardt(pixels, points, camera, world_from_camera, factors, scale_px, max_steps)


def _checked_weights(weights: ArrayLike | None, count: int) -> Array:
    if weights is None:
        return np.ones(count)
    factors = np.asarray(weights, dtype=np.float64)
    if factors.shape != (count,) or not np.isfinite(factors).all() or (factors < 0).any():
        raise InvalidInputError(f"Weights must be {count} finite numbers that are not negative.")
    return factors


def _levenberg_marquardt(
    pixels: Array, points: Array, camera: Camera, pose: Pose, weights: Array, scale_px: float, max_steps: int
) -> Pose:
    damping, cost = OPTIONS.initial_damping, _cost(pixels, points, camera, pose, weights, scale_px)
    gradient, hessian = _normal_equations(pixels, points, camera, pose, weights, scale_px)
    for _ in range(max_steps):
        # Damping relative to the diagonal doesn't depend on the units. The lower bound keeps the matrix
        # invertible when the points don't determine a direction.
        diagonal = np.diag(hessian)
        damped = hessian + np.diag(damping * diagonal + 1e-12 * diagonal.max() + 1e-300)
        step = -np.linalg.solve(damped, gradient)
        candidate = perturbed(pose, step)
        candidate_cost = _cost(pixels, points, camera, candidate, weights, scale_px)
        if candidate_cost > cost:
            damping *= 10.0
            if damping > OPTIONS.max_damping:
                break
            continue
        gain, pose, cost = cost - candidate_cost, candidate, candidate_cost
        if gain <= OPTIONS.min_gain_ratio * cost or float(np.abs(step).max()) < OPTIONS.min_step:
            break
        damping = max(damping * 0.1, OPTIONS.min_damping)
        gradient, hessian = _normal_equations(pixels, points, camera, pose, weights, scale_px)
    return pose


def _cost(pixels: Array, points: Array, camera: Camera, pose: Pose, weights: Array, scale_px: float) -> float:
    errors = np.minimum(reprojection_errors_px(pixels, points, camera, pose), OPTIONS.behind_camera_px)
    if np.isinf(scale_px):
        return float(weights @ errors**2)
    return float(weights @ (scale_px**2 * np.log1p((errors / scale_px) ** 2)))


def _normal_equations(
    pixels: Array, points: Array, camera: Camera, pose: Pose, weights: Array, scale_px: float
) -> tuple[Array, Array]:
    projected, jacobian, _ = reprojection_jacobian(points, camera, pose)
    residuals = projected - pixels
    seen = np.isfinite(residuals).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    residuals, jacobian = residuals[seen], jacobian[seen]
    # The derivative of the loss by the squared error: the weight in a reweighted least-squares step.
    robust = weights[seen] / (1.0 + np.sum(residuals**2, axis=1) / scale_px**2)
    weighted = (jacobian * robust[:, None, None]).reshape(-1, 6)
    return weighted.T @ residuals.reshape(-1), weighted.T @ jacobian.reshape(-1, 6)


def _opencv_view(pixels: Array, camera: Camera) -> tuple[Array, Array]:
    """Return pixels (n, 2) and distortion for OpenCV's solvers, which don't support a fisheye."""
    if camera.model == "OPENCV_FISHEYE":
        return camera.undistort(pixels), np.zeros(4)
    return pixels, camera.distortion


def poselib_camera(camera: Camera) -> poselib.Camera:
    """Return the camera for PoseLib, which follows COLMAP's names and parameter order too."""
    return poselib.Camera(camera.model, camera.params, camera.width, camera.height)


def bundle_options(loss_scale_px: float) -> dict[str, Any]:
    """Return PoseLib's options for a refinement with the Cauchy loss."""
    return {"loss_type": "CAUCHY", "loss_scale": loss_scale_px, "max_iterations": OPTIONS.poselib_steps}


def poselib_pose(world_from_camera: Pose) -> poselib.CameraPose:
    """Return `camera_from_world` for PoseLib."""
    camera_from_world = world_from_camera.inverse()
    x, y, z, w = quaternion_from_rotation(camera_from_world.rotation)
    pose = poselib.CameraPose()
    pose.q, pose.t = np.array([w, x, y, z]), np.array(camera_from_world.translation)
    return pose
