"""The focal length of a camera nobody knows, found together with its pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from app.geometry.camera import Camera
from app.geometry.pnp import estimate_pose_lo_ransac, refine_pose
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose

Array = NDArray[np.float64]

# From 94 degrees of view along the longer side to 28: the cameras of phones and tablets.
MIN_FOCAL, MAX_FOCAL = 0.47, 2.0
CANDIDATES = 13
# RANSAC at a focal length that is off by half a step allows for so much more error.
ROUGH_ERROR = 1.7
ROUGH_ITERATIONS = 1500
LOSS_SCALE_PX = 2.0


def pinhole(width: int, height: int, focal_px: float) -> Camera:
    """Return the pinhole of one focal length whose principal point is the image's centre."""
    return Camera("PINHOLE", width, height, (focal_px, focal_px, 0.5 * (width - 1), 0.5 * (height - 1)))


def search_camera(
    points_px: Array, points_in_world: Array, width: int, height: int, max_error: float, min_inliers: int
) -> Camera | None:
    """Return the pinhole, its principal point in the centre, that explains most matches best, or None.

    Pixels (n, 2) and world points (n, 3) may hold outliers; `max_error` is the inlier limit over the focal
    length. A short RANSAC at each of thirteen focal lengths, spaced evenly in their logarithm, finds the rough
    one; `refine_camera` does the rest. None with fewer than `min_inliers`.
    """
    focals = np.geomspace(MIN_FOCAL, MAX_FOCAL, CANDIDATES) * max(width, height)
    best: tuple[int, Camera, Pose, NDArray[np.bool_]] | None = None
    for focal_px in focals:
        camera = pinhole(width, height, float(focal_px))
        # Off by half a step a focal length shifts points at the border by 6 % of their distance to the centre.
        found = estimate_pose_lo_ransac(
            points_px,
            points_in_world,
            camera,
            max_error_px=ROUGH_ERROR * max_error * focal_px,
            max_iterations=ROUGH_ITERATIONS,
        )
        if found is not None and (best is None or found.inlier_mask.sum() > best[0]):
            best = int(found.inlier_mask.sum()), camera, found.world_from_camera, found.inlier_mask
    if best is None or best[0] < min_inliers:
        return None
    _, camera, pose, inliers = best
    return refine_camera(points_px[inliers], points_in_world[inliers], camera, pose)


def refine_camera(points_px: Array, points_in_world: Array, camera: Camera, pose: Pose) -> Camera | None:
    """Return the centred pinhole near a camera at which the refined pose has the least robust reprojection error.

    Takes the inliers of `pose`: pixels (n, 2), world points (n, 3). None when the best focal length is at the
    end of the range of one and a half steps of the search, which is no minimum.
    """
    step = (MAX_FOCAL / MIN_FOCAL) ** (1.5 / (CANDIDATES - 1))
    low, high = np.log(camera.focal_px / step), np.log(camera.focal_px * step)
    pixels, points = points_px, points_in_world

    def cost(log_focal: float) -> float:
        candidate = pinhole(camera.width, camera.height, float(np.exp(log_focal)))
        refined = refine_pose(pixels, points, candidate, pose, loss_scale_px=LOSS_SCALE_PX)
        errors = np.minimum(reprojection_errors_px(pixels, points, candidate, refined), 1e3)
        return float(np.log1p((errors / LOSS_SCALE_PX) ** 2).sum())

    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3})
    if min(found.x - low, high - found.x) < 0.01:
        return None
    return pinhole(camera.width, camera.height, float(np.exp(found.x)))
