"""Robust estimators by OpenCV's USAC and our own refinement, where PoseLib has no wheel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.estimators.interface import MIN_POINTS, AbsolutePose, RansacBudget
from app.geometry.estimators.opencv_relative_pose import sampled_relative_pose
from app.geometry.estimators.upright_solver import upright_relative_poses
from app.geometry.pose_refinement import refine_pose
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.rigs.refinement import refine_rig_pose
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]
NO_DISTORTION = np.zeros(4)


@dataclass(frozen=True, slots=True, kw_only=True)
class UsacOptions:
    """OpenCV's USAC, and the refinement after it."""

    confidence: float = limit(
        0.9999,
        "USAC ends when a sample without outliers was drawn with this probability.",
        chosen="By hand: above the 0.999 of the other estimators, since USAC draws no least number of samples.",
    )
    searches: int = limit(
        3,
        "Searches for an absolute pose, with a seed each, of which the best is taken.",
        chosen="By hand: one search ends in a minimum near the best one in about half of the frames that odometry has "
        "followed for long; of three, one is there.",
    )
    pose_rounds: int = limit(
        10,
        "Most rounds in which inliers are chosen and the absolute pose of least squares is found on them.",
        chosen="By hand: they end when the inliers stay the same, which takes two or three rounds.",
    )
    rig_rounds: int = limit(
        2,
        "Rounds in which inliers are chosen and the pose of a rig is refined on them.",
        chosen="By hand: the second round has the inliers of a pose that is refined already.",
    )


OPTIONS = UsacOptions()


class OpenCvEstimators:
    """See `Estimators`. USAC (MSAC score, inner local optimization) finds poses, our refinement ends the best.

    `min_iterations` of a budget has no counterpart in USAC and is not used; the number of samples is not reported.
    """

    name = "OpenCV"

    def absolute_poses(
        self,
        pixels: Array,
        points: Array,
        searches: Sequence[tuple[Camera, RansacBudget]],
        *,
        loss_scale_px: float,
        prior: Pose | None,
    ) -> list[AbsolutePose | None]:
        return [
            _absolute_pose(pixels, points, camera, budget, loss_scale_px, prior)
            for camera, budget in searches
        ]

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
        return sampled_relative_pose(pixels_a, pixels_b, cameras, budget.max_error_px, usac_params(budget))

    def upright_relative_poses(self, rays_a: Array, rays_b: Array) -> tuple[Array, Array]:
        return upright_relative_poses(rays_a, rays_b)


def usac_params(budget: RansacBudget) -> cv2.UsacParams:
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


def _absolute_pose(
    pixels: Array,
    points: Array,
    camera: Camera,
    budget: RansacBudget,
    loss_scale_px: float,
    prior: Pose | None,
) -> AbsolutePose | None:
    """Return the best of the poses that samples and the prior lead to, None where none is determined."""
    best, least_cost, tried = None, np.inf, list[Pose]()
    for start in (*_sampled_poses(pixels, points, camera, budget), prior):
        if start is None or any(_is_same(start, each) for each in tried):
            continue
        tried.append(start)
        found = _on_its_inliers(pixels, points, camera, start, budget.max_error_px)
        if found is None:
            continue
        errors = reprojection_errors_px(pixels, points, camera, found)
        cost = float(np.minimum((errors / budget.max_error_px) ** 2, 1.0).sum())
        if cost < least_cost:
            best, least_cost = found, cost
    if best is None:
        return None
    return _robust(pixels, points, camera, best, budget.max_error_px, loss_scale_px)


def _sampled_pose(pixels: Array, points: Array, camera: Camera, budget: RansacBudget) -> Pose | None:
    # USAC computes in single precision: points far from the origin would lose digits.
    centre = np.median(points, axis=0)
    try:
        ok, _, turn, translation, _ = cv2.solvePnPRansac(
            points - centre, camera.undistort(pixels), camera.K, NO_DISTORTION, params=usac_params(budget)
        )
    except cv2.error:  # Raised for sets of points that no pose fits.
        return None
    if not ok or not (np.isfinite(turn).all() and np.isfinite(translation).all()):
        return None
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    camera_from_centre = Pose(rotation, np.asarray(translation[:, 0], dtype=np.float64))
    return Pose(np.eye(3), centre) @ camera_from_centre.inverse()


def _sampled_poses(pixels: Array, points: Array, camera: Camera, budget: RansacBudget) -> list[Pose | None]:
    seeds = range(budget.seed, budget.seed + OPTIONS.searches)
    return [_sampled_pose(pixels, points, camera, replace(budget, seed=seed)) for seed in seeds]


def _is_same(a: Pose, b: Pose) -> bool:
    return bool(np.array_equal(a.rotation, b.rotation) and np.array_equal(a.translation, b.translation))


def _on_its_inliers(
    pixels: Array, points: Array, camera: Camera, pose: Pose, max_error_px: float
) -> Pose | None:
    """Return the pose of least squares on its own inliers, or None when it has fewer than four.

    Inliers are chosen anew until they stay the same: then the pose is a minimum of the truncated squares by which poses
    are compared.
    """
    before = None
    for _ in range(OPTIONS.pose_rounds):
        inliers = reprojection_errors_px(pixels, points, camera, pose) <= max_error_px
        if np.count_nonzero(inliers) < MIN_POINTS:
            return None
        if before is not None and np.array_equal(inliers, before):
            break
        before = inliers
        try:
            pose = refine_pose(pixels[inliers], points[inliers], camera, pose, loss="trivial")
        except DegenerateGeometryError:
            return None
    return pose


def _robust(
    pixels: Array, points: Array, camera: Camera, pose: Pose, max_error_px: float, loss_scale_px: float
) -> AbsolutePose | None:
    """Return the pose of least robust loss on its inliers, or None when these don't determine it."""
    inliers = reprojection_errors_px(pixels, points, camera, pose) <= max_error_px
    try:
        refined = refine_pose(pixels[inliers], points[inliers], camera, pose, loss_scale_px=loss_scale_px)
    except DegenerateGeometryError:
        return None
    return AbsolutePose(refined, 0)


def _refined_rig(views: Sequence[RigView], pose: Pose, tangent: float, loss_scale_px: float) -> Pose | None:
    """Return a rig's pose refined on its inliers, or None when it has fewer than four."""
    for _ in range(OPTIONS.rig_rounds):
        inliers = [view.take(view.errors_px(pose) <= tangent * view.camera.focal_px) for view in views]
        if sum(len(view.points_px) for view in inliers) < MIN_POINTS:
            return None
        pose = refine_rig_pose(inliers, pose, loss_scale_px)
    return pose
