"""A relative pose by OpenCV's USAC and our own refinement, where PoseLib has no wheel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.estimators.interface import MIN_FUNDAMENTAL_POINTS
from app.geometry.estimators.relative_refinement import RelativePoseProblem
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous, pixel_depths
from app.limits import limit

Array = NDArray[np.float64]
NO_DISTORTION = np.zeros(4)
# `recoverPose` leaves out points beyond this many baselines; all of them count here.
ANY_DISTANCE = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativePoseOptions:
    """The refinement after USAC."""

    steps: int = limit(
        8,
        "Gauss-Newton steps for a relative pose.",
        chosen="By hand: as many as a relative pose with known verticals gets.",
    )


OPTIONS = RelativePoseOptions()


def sampled_relative_pose(
    pixels_a: Array,
    pixels_b: Array,
    cameras: tuple[Camera, Camera],
    max_error_px: float,
    usac: cv2.UsacParams,
) -> Pose | None:
    """Return the `b_from_a` with the most inliers among matched pixels (n, 2), (n, 2), n >= 8, or None.

    Its translation has length 1. Points on one plane fit two poses nearly as well, and USAC returns either: both start
    a refinement, and the one of least cost is the answer.
    """
    rays_a, rays_b = cameras[0].normalize(pixels_a), cameras[1].normalize(pixels_b)
    # With the mean focal length, the rays' errors are in pixels of the mean of both images.
    focal_px = 0.5 * (cameras[0].focal_px + cameras[1].focal_px)
    K = np.diag([focal_px, focal_px, 1.0])
    try:
        essential, mask = cv2.findEssentialMat(
            focal_px * rays_a, focal_px * rays_b, K, K, NO_DISTORTION, NO_DISTORTION, usac
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
    # Over all matches, not those of the first pose: another one may have more of them.
    problem = RelativePoseProblem(homogeneous(rays_a), homogeneous(rays_b), None, max_error_px / focal_px)
    first = np.asarray(rotation, dtype=np.float64), np.asarray(translation[:, 0], dtype=np.float64)
    starts = [first, *_poses_by_a_plane(focal_px * rays_a[kept], focal_px * rays_b[kept], K, usac)]
    refined = [problem.refined(*start, OPTIONS.steps) for start in starts]
    _, *best = min(refined, key=lambda each: each[0])
    return _in_front(rays_a[kept], rays_b[kept], Pose(*best))


def _poses_by_a_plane(
    points_a: Array, points_b: Array, K: Array, usac: cv2.UsacParams
) -> list[tuple[Array, Array]]:
    """Return the rotations and translations by which most matches (n, 2), (n, 2) can lie on one plane."""
    try:
        homography, _ = cv2.findHomography(points_a, points_b, usac)
        if homography is None:
            return []
        _, rotations, translations, _ = cv2.decomposeHomographyMat(homography, K)
    except cv2.error:  # Raised for matches that no sample gives a matrix for.
        return []
    lengths = [float(np.linalg.norm(translation)) for translation in translations]
    # Each rotation comes with a translation and its opposite, which have the same errors.
    return [
        (np.asarray(rotation, dtype=np.float64), np.asarray(translation[:, 0] / length, dtype=np.float64))
        for rotation, translation, length in zip(rotations, translations, lengths, strict=True)
        if length > 0.0
    ][::2]


def _in_front(rays_a: Array, rays_b: Array, pose: Pose) -> Pose:
    """Return the pose, its translation turned round if that puts more points in front of both cameras."""
    opposite = Pose(pose.rotation, -pose.translation)
    counts = []
    for each in (pose, opposite):
        depths_a, depths_b = pixel_depths(rays_a, rays_b, each)
        counts.append(np.count_nonzero((depths_a > 0) & (depths_b > 0)))
    return pose if counts[0] >= counts[1] else opposite
