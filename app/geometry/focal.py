"""The focal length of a camera nobody knows, found together with its pose."""

from __future__ import annotations

from dataclasses import dataclass

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
# Off by half a step a focal length shifts points at the border by 6 % of their distance to the centre: RANSAC
# allows for so many times the error.
ROUGH_ERROR, ROUGH_ITERATIONS = 1.7, 1500
BAND_ERROR = 1.5
LOSS_SCALE_PX = 2.0
# How far off the focal length of a photo's tags may be: a standard deviation, and the band that is searched.
TAG_SIGMA = 0.05
BAND_LOW, BAND_HIGH = 0.85, 1.18
BAND_STEPS = np.array([1.0, 0.93, 1.07])  # the first of those that hold equally many inliers is taken
# Matches are not independent: a feature is matched in several keyframes, whose points share the map's errors.
# Measured: with this say stated accuracies hold.
MATCH_SAY = 0.2


@dataclass(frozen=True, slots=True)
class ApproximateCamera:
    """A pinhole whose focal length is only nearly known."""

    camera: Camera

    def covers(self, camera: Camera) -> bool:
        """Return whether a camera's focal length is within the band that this one stands for."""
        return BAND_LOW <= camera.focal_px / self.camera.focal_px <= BAND_HIGH


def focal_sigma_of(known: Camera | ApproximateCamera | None, found: Camera) -> float:
    """Return the relative error of what was known of a camera's focal length before it was found."""
    if isinstance(known, Camera):
        return 0.0
    return TAG_SIGMA if known is not None and known.covers(found) else float("inf")


def find_camera(
    points_px: Array,
    points_in_world: Array,
    width: int,
    height: int,
    max_error: float,
    min_inliers: int,
    near: ApproximateCamera | None = None,
) -> Camera | None:
    """Return the pinhole near an approximate one that explains most matches best, else the one of `search_camera`.

    A focal length at the border of the band, or too few inliers in it, means that the approximation is wrong.
    """
    if near is not None:
        found = _near_camera(points_px, points_in_world, near.camera, max_error, min_inliers)
        if found is not None:
            return found
    return search_camera(points_px, points_in_world, width, height, max_error, min_inliers)


def _near_camera(
    points_px: Array, points_in_world: Array, near: Camera, max_error: float, min_inliers: int
) -> Camera | None:
    size = near.width, near.height
    best = _best_of(near.focal_px * BAND_STEPS, points_px, points_in_world, size, BAND_ERROR * max_error)
    if best is None or best[0] < min_inliers:
        return None
    focals = np.geomspace(MIN_FOCAL, MAX_FOCAL, CANDIDATES) * max(size)
    outside = focals[(focals < near.focal_px * BAND_LOW) | (focals > near.focal_px * BAND_HIGH)]
    far = _best_of(outside, points_px, points_in_world, size, BAND_ERROR * max_error)
    # A wrong focal length still finds matches to fit; that another one fits more tells it.
    if far is not None and far[0] > best[0]:
        return None
    _, _, pose, inliers = best
    low, high = np.log(near.focal_px * np.array([BAND_LOW, BAND_HIGH]))
    bounds = float(low), float(high)
    return _refined(points_px[inliers], points_in_world[inliers], near, pose, bounds, TAG_SIGMA)


def _best_of(
    focals_px: Array, points_px: Array, points_in_world: Array, size: tuple[int, int], max_error: float
) -> tuple[int, Camera, Pose, NDArray[np.bool_]] | None:
    """Return inlier count, camera, pose and inliers (n,) of the focal length with most inliers, in an image of
    `size` (width, height)."""
    best: tuple[int, Camera, Pose, NDArray[np.bool_]] | None = None
    for focal_px in focals_px:
        camera = pinhole(*size, float(focal_px))
        found = estimate_pose_lo_ransac(
            points_px,
            points_in_world,
            camera,
            max_error_px=max_error * focal_px,
            max_iterations=ROUGH_ITERATIONS,
        )
        if found is not None and (best is None or found.inlier_mask.sum() > best[0]):
            best = int(found.inlier_mask.sum()), camera, found.world_from_camera, found.inlier_mask
    return best


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
    best = _best_of(focals, points_px, points_in_world, (width, height), ROUGH_ERROR * max_error)
    if best is None or best[0] < min_inliers:
        return None
    _, camera, pose, inliers = best
    return refine_camera(points_px[inliers], points_in_world[inliers], camera, pose)


def refine_camera(
    points_px: Array,
    points_in_world: Array,
    camera: Camera,
    pose: Pose,
    near: ApproximateCamera | None = None,
) -> Camera | None:
    """Return the centred pinhole near a camera at which the refined pose has the least robust reprojection error.

    Takes the inliers of `pose`: pixels (n, 2), world points (n, 3). A camera that is nearly known has a say if
    the found one is in its band. None when the best focal length is at the end of the range of one and a half
    steps of the search, which is no minimum.
    """
    if near is not None and near.covers(camera):
        low, high = np.log(near.camera.focal_px * np.array([BAND_LOW, BAND_HIGH]))
        bounds = float(low), float(high)
        return _refined(points_px, points_in_world, near.camera, pose, bounds, TAG_SIGMA)
    step = (MAX_FOCAL / MIN_FOCAL) ** (1.5 / (CANDIDATES - 1))
    bounds = float(np.log(camera.focal_px / step)), float(np.log(camera.focal_px * step))
    return _refined(points_px, points_in_world, camera, pose, bounds)


def _refined(
    pixels: Array,
    points: Array,
    camera: Camera,
    pose: Pose,
    bounds: tuple[float, float],
    sigma: float | None = None,
) -> Camera | None:
    """Return the camera of least cost with the logarithm of its focal length within bounds, None at their ends.

    With `sigma` the given focal length has a say too, as a normal prior on the logarithm.
    """
    known = float(np.log(camera.focal_px))

    def cost(log_focal: float) -> float:
        candidate = pinhole(camera.width, camera.height, float(np.exp(log_focal)))
        refined = refine_pose(pixels, points, candidate, pose, loss_scale_px=LOSS_SCALE_PX)
        prior = 0.0 if sigma is None else 0.5 * ((log_focal - known) / sigma) ** 2
        return _cost(pixels, points, candidate, refined) + prior

    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    if min(found.x - bounds[0], bounds[1] - found.x) < 0.01:
        return None
    return pinhole(camera.width, camera.height, float(np.exp(found.x)))


def _cost(pixels: Array, points: Array, camera: Camera, pose: Pose) -> float:
    errors = np.minimum(reprojection_errors_px(pixels, points, camera, pose), 1e3)
    return MATCH_SAY * float(np.log1p((errors / LOSS_SCALE_PX) ** 2).sum())
