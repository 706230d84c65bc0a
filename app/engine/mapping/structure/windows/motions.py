"""The motions that the matches of two pictures allow: one, or two where all they show lies on one plane."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera, tangent_of_px
from app.geometry.epipolar import OPTIONS as EPIPOLAR
from app.geometry.epipolar import estimate_relative_pose, relative_estimate
from app.geometry.estimators.relative_refinement import RelativePoseProblem
from app.geometry.se3 import Pose, attitude_difference_rad
from app.geometry.triangulation import homogeneous
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionOptions:
    """When a second motion is considered."""

    plane_error_px: float = limit(
        2.0,
        "Largest distance of a match from where the homography of a plane puts it.",
        chosen="By hand: a pixel or two of noise.",
    )
    min_plane_share: float = limit(
        0.7,
        "Share of the matches on one plane from which on the plane's two motions are considered.",
        chosen="By hand, on stretches of the video of `roomfix evaluate-video`: wrong motions came where 94 % and "
        "more lay on one plane.",
    )
    min_inlier_share: float = limit(
        0.85,
        "Least number of matches that agree with another motion, relative to those of the first.",
        chosen="By hand: both motions of a plane fit nearly as well.",
    )
    min_turn_deg: float = limit(
        0.7, "Least difference of the turns of two motions.", chosen="By hand: else they are the same one."
    )
    steps: int = limit(
        8, "Gauss-Newton steps of the refinement of a plane's motion.", chosen="As of other relative poses."
    )


OPTIONS = MotionOptions()


@dataclass(frozen=True, slots=True)
class Motion:
    """A `b_from_a` whose translation has length 1, and which of the matches (n,) agree with it."""

    b_from_a: Pose
    inliers: NDArray[np.bool_]


def motions_of(pixels_a: Array, pixels_b: Array, camera: Camera, min_inliers: int) -> list[Motion]:
    """Return the motions that matched pixels (n, 2), (n, 2) allow, the one with most inliers first.

    Matches on one plane fit two motions, whose turns may differ by tens of degrees; which one is right only further
    pictures tell. Source: Faugeras and Lustman, "Motion and structure from motion in a piecewise planar environment",
    1988, by OpenCV.
    """
    limit_px = tangent_of_px(EPIPOLAR.relative_error_px) * camera.focal_px
    first = estimate_relative_pose(pixels_a, pixels_b, camera, camera, max_error_px=limit_px)
    if first is None or np.count_nonzero(first.inlier_mask) < min_inliers:
        return []
    found = [Motion(first.b_from_a, first.inlier_mask)]
    least = OPTIONS.min_inlier_share * np.count_nonzero(first.inlier_mask)
    for motion in _by_a_plane(pixels_a, pixels_b, first.inlier_mask, camera, limit_px):
        turns = [attitude_difference_rad(motion.b_from_a, other.b_from_a) for other in found]
        if np.count_nonzero(motion.inliers) >= least and min(turns) > np.radians(OPTIONS.min_turn_deg):
            found.append(motion)
    return found


def _by_a_plane(
    pixels_a: Array, pixels_b: Array, inliers: NDArray[np.bool_], camera: Camera, limit_px: float
) -> list[Motion]:
    rays_a, rays_b = camera.normalize(pixels_a[inliers]), camera.normalize(pixels_b[inliers])
    cv2.setRNGSeed(0)
    plane_error = tangent_of_px(OPTIONS.plane_error_px)
    homography, mask = cv2.findHomography(rays_a, rays_b, cv2.USAC_MAGSAC, plane_error)
    if homography is None or mask.mean() < OPTIONS.min_plane_share:
        return []
    _, rotations, translations, _ = cv2.decomposeHomographyMat(homography, np.eye(3))
    problem = RelativePoseProblem(homogeneous(rays_a), homogeneous(rays_b), None, limit_px / camera.focal_px)
    found = []
    for rotation, translation in zip(rotations, translations, strict=True):
        length = float(np.linalg.norm(translation))
        if length < 1e-9:
            continue
        start = (
            np.asarray(rotation, dtype=np.float64),
            np.asarray(translation[:, 0] / length, dtype=np.float64),
        )
        try:
            _, *best = problem.refined(*start, OPTIONS.steps)
        except np.linalg.LinAlgError:  # No match is near enough to pull at the motion.
            continue
        estimate = relative_estimate(pixels_a, pixels_b, camera, camera, Pose(*best), limit_px)
        if estimate is not None:
            found.append(Motion(estimate.b_from_a, estimate.inlier_mask))
    return found
