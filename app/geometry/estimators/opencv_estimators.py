"""Robust estimators by OpenCV's USAC and our own refinement, where PoseLib has no wheel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.estimators.interface import MIN_FUNDAMENTAL_POINTS, MIN_POINTS, AbsolutePose, RansacBudget
from app.geometry.estimators.relative_refinement import RelativePoseProblem
from app.geometry.estimators.upright_solver import upright_relative_poses
from app.geometry.pose_refinement import refine_pose
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.rigs.refinement import refine_rig_pose
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit

Array = NDArray[np.float64]
NO_DISTORTION = np.zeros(4)
# `recoverPose` leaves out points beyond this many baselines; all of them count here.
ANY_DISTANCE = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class UsacOptions:
    """OpenCV's USAC, and the refinement after it."""

    confidence: float = limit(
        0.9999,
        "USAC ends when a sample without outliers was drawn with this probability.",
        chosen="By hand: above the 0.999 of the other estimators, since USAC draws no least number of samples.",
    )
    pose_rounds: int = limit(
        2,
        "Rounds in which inliers are chosen and the absolute pose is refined on them.",
        chosen="By hand: the second round has the inliers of a pose that is refined already.",
    )
    relative_steps: int = limit(
        8,
        "Gauss-Newton steps for a relative pose.",
        chosen="By hand: as many as a relative pose with known verticals gets.",
    )


OPTIONS = UsacOptions()


class OpenCvEstimators:
    """See `Estimators`. USAC (MSAC score, inner local optimization) finds the pose, our refinement ends it.

    `min_iterations` of a budget has no counterpart in USAC and is not used; the number of samples is not reported.
    """

    name = "OpenCV"

    def absolute_pose(
        self,
        pixels: Array,
        points: Array,
        camera: Camera,
        budget: RansacBudget,
        *,
        loss_scale_px: float,
        prior: Pose | None,
    ) -> AbsolutePose | None:
        best, least_cost = None, np.inf
        for start in (_sampled_pose(pixels, points, camera, budget), prior):
            refined = start and _refined(pixels, points, camera, start, budget.max_error_px, loss_scale_px)
            if refined is None:
                continue
            errors = reprojection_errors_px(pixels, points, camera, refined)
            cost = float(np.minimum((errors / budget.max_error_px) ** 2, 1.0).sum())
            if cost < least_cost:
                best, least_cost = refined, cost
        return None if best is None else AbsolutePose(best, 0)

    def rig_pose(
        self, views: Sequence[RigView], budget: RansacBudget, *, loss_scale_px: float
    ) -> Pose | None:
        """OpenCV has no generalized estimator: samples are drawn from one view at a time, and count in all."""
        tangent = budget.max_error_px / views[0].camera.focal_px
        best, least_cost = None, np.inf
        for view in views:
            own = replace(budget, max_error_px=tangent * view.camera.focal_px)
            if len(view.points_px) < MIN_POINTS:
                continue
            start = _sampled_pose(view.points_px, view.points_in_world, view.camera, own)
            refined = start and _refined_rig(
                views, start @ view.rig_from_camera.inverse(), tangent, loss_scale_px
            )
            if refined is None:
                continue
            cost = sum(
                float(
                    np.minimum((each.errors_px(refined) / (tangent * each.camera.focal_px)) ** 2, 1.0).sum()
                )
                for each in views
            )
            if cost < least_cost:
                best, least_cost = refined, cost
        return best

    def relative_pose(
        self, pixels_a: Array, pixels_b: Array, cameras: tuple[Camera, Camera], budget: RansacBudget
    ) -> Pose | None:
        rays_a, rays_b = cameras[0].normalize(pixels_a), cameras[1].normalize(pixels_b)
        # With the mean focal length, the rays' errors are in pixels of the mean of both images.
        focal_px = 0.5 * (cameras[0].focal_px + cameras[1].focal_px)
        K = np.diag([focal_px, focal_px, 1.0])
        try:
            essential, mask = cv2.findEssentialMat(
                focal_px * rays_a, focal_px * rays_b, K, K, NO_DISTORTION, NO_DISTORTION, _usac(budget)
            )
            if essential is None or essential.shape != (3, 3):
                return None
            _, rotation, translation, front, _ = cv2.recoverPose(
                essential, rays_a, rays_b, np.eye(3), distanceThresh=ANY_DISTANCE, mask=mask.copy()
            )
        except cv2.error:  # Raised for matches that no sample gives a matrix for.
            return None
        kept = front[:, 0] != 0
        if np.count_nonzero(kept) < MIN_FUNDAMENTAL_POINTS:
            return None
        rays = homogeneous(rays_a[kept]), homogeneous(rays_b[kept])
        problem = RelativePoseProblem(*rays, None, budget.max_error_px / focal_px)
        start = np.asarray(rotation, dtype=np.float64), np.asarray(translation[:, 0], dtype=np.float64)
        _, refined_rotation, refined_translation = problem.refined(*start, OPTIONS.relative_steps)
        return Pose(refined_rotation, refined_translation)

    def upright_relative_poses(self, rays_a: Array, rays_b: Array) -> tuple[Array, Array]:
        return upright_relative_poses(rays_a, rays_b)


def _usac(budget: RansacBudget) -> cv2.UsacParams:
    params = cv2.UsacParams()
    params.threshold = budget.max_error_px
    params.maxIterations = budget.max_iterations
    params.confidence = OPTIONS.confidence
    params.randomGeneratorState = budget.seed
    params.score = cv2.SCORE_METHOD_MSAC
    params.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    params.final_polisher = cv2.LSQ_POLISHER
    params.sampler = cv2.SAMPLING_PROSAC if budget.sorted_by_quality else cv2.SAMPLING_UNIFORM
    return params


def _sampled_pose(pixels: Array, points: Array, camera: Camera, budget: RansacBudget) -> Pose | None:
    # USAC computes in single precision: points far from the origin would lose digits.
    centre = np.median(points, axis=0)
    try:
        ok, _, turn, translation, _ = cv2.solvePnPRansac(
            points - centre, camera.undistort(pixels), camera.K, NO_DISTORTION, params=_usac(budget)
        )
    except cv2.error:  # Raised for sets of points that no pose fits.
        return None
    if not ok or not (np.isfinite(turn).all() and np.isfinite(translation).all()):
        return None
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    camera_from_centre = Pose(rotation, np.asarray(translation[:, 0], dtype=np.float64))
    return Pose(np.eye(3), centre) @ camera_from_centre.inverse()


def _refined(
    pixels: Array, points: Array, camera: Camera, pose: Pose, max_error_px: float, loss_scale_px: float
) -> Pose | None:
    """Return a pose refined on its inliers, or None when it has fewer than four."""
    for _ in range(OPTIONS.pose_rounds):
        inliers = reprojection_errors_px(pixels, points, camera, pose) <= max_error_px
        if np.count_nonzero(inliers) < MIN_POINTS:
            return None
        try:
            pose = refine_pose(pixels[inliers], points[inliers], camera, pose, loss_scale_px=loss_scale_px)
        except DegenerateGeometryError:
            return None
    return pose


def _refined_rig(views: Sequence[RigView], pose: Pose, tangent: float, loss_scale_px: float) -> Pose | None:
    """Return a rig's pose refined on its inliers, or None when it has fewer than four."""
    for _ in range(OPTIONS.pose_rounds):
        inliers = [view.take(view.errors_px(pose) <= tangent * view.camera.focal_px) for view in views]
        if sum(len(view.points_px) for view in inliers) < MIN_POINTS:
            return None
        pose = refine_rig_pose(inliers, pose, loss_scale_px)
    return pose
