"""The pose of a camera from pixels and the world points that they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.epnp import MIN_EPNP_POINTS, solve_epnp
from app.geometry.estimators.chosen import ESTIMATORS
from app.geometry.estimators.interface import MIN_POINTS, RansacBudget
from app.geometry.pose_refinement import refine_pose
from app.geometry.reprojection import PIXEL_NOISE, View, reprojection_errors_of_views, reprojection_errors_px
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
    Raises `InvalidInputError` for numbers that are not finite. Source: LO-RANSAC by `ESTIMATORS`; minimizes C
    eq. 5.1.2.
    """
    return estimate_poses_lo_ransac(
        points_px,
        points_in_world,
        [(camera, max_error_px)],
        max_iterations=max_iterations,
        min_iterations=min_iterations,
        loss_scale_px=loss_scale_px,
        seed=seed,
        prior=prior,
        sorted_by_quality=sorted_by_quality,
    )[0]


def estimate_poses_lo_ransac(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    cameras: Sequence[tuple[Camera, float]],
    *,
    max_iterations: int = OPTIONS.lo_ransac_iterations,
    min_iterations: int = OPTIONS.min_lo_ransac_iterations,
    loss_scale_px: float = PIXEL_NOISE.loss_scale_px,
    seed: int = 0,
    prior: Pose | None = None,
    sorted_by_quality: bool = False,
) -> list[PnpEstimate | None]:
    """Return the pose by each of several cameras that may have taken one picture, each with its inlier limit in pixels,
    as `estimate_pose_lo_ransac` returns it by one."""
    searches = [
        (
            camera,
            RansacBudget(
                max_error_px=max_error_px,
                max_iterations=max_iterations,
                min_iterations=min(min_iterations, max_iterations),
                seed=seed,
                sorted_by_quality=sorted_by_quality,
            ),
        )
        for camera, max_error_px in cameras
    ]
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    if len(pixels) < MIN_POINTS:
        return [None] * len(cameras)
    found = ESTIMATORS.absolute_poses(pixels, points, searches, loss_scale_px=loss_scale_px, prior=prior)
    views: list[View] = []
    for (camera, _), each in zip(cameras, found, strict=True):
        views.append((camera, None if each is None else each.world_from_camera))
    estimates: list[PnpEstimate | None] = []
    errors = reprojection_errors_of_views(pixels, points, views)
    for (_, max_error_px), each, errors_px in zip(cameras, found, errors, strict=True):
        inliers = errors_px <= max_error_px
        if each is None or np.count_nonzero(inliers) < MIN_POINTS:
            estimates.append(None)
            continue
        rms_px = float(np.sqrt(np.mean(errors_px[inliers] ** 2)))
        estimates.append(PnpEstimate(each.world_from_camera, inliers, rms_px, each.iterations))
    return estimates


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
    errors_px = reprojection_errors_px(pixels, points, camera, pose)
    agree = errors_px <= max_error_px
    if np.count_nonzero(agree) < MIN_POINTS:
        return None
    return PnpEstimate(pose, agree, float(np.sqrt(np.mean(errors_px[agree] ** 2))), 0)


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


def _opencv_view(pixels: Array, camera: Camera) -> tuple[Array, Array]:
    """Return pixels (n, 2) and distortion for OpenCV's solvers, which don't support a fisheye."""
    if camera.model == "OPENCV_FISHEYE":
        return camera.undistort(pixels), np.zeros(4)
    return pixels, camera.distortion
