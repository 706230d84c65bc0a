"""The focal length of a camera that is not calibrated, estimated together with its pose."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from app.geometry.camera import Camera
from app.geometry.pnp import estimate_poses_lo_ransac
from app.geometry.pose_refinement import refine_pose
from app.geometry.reprojection import PIXEL_NOISE, reprojection_errors_px
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalOptions:
    """Which focal lengths are searched, and what a focal length from a photo's tags is worth."""

    min_focal_ratio: float = limit(
        0.47,
        "Least focal length of the search, over the longer side of the image.",
        chosen="By hand: 94 degrees of view; the cameras of phones and tablets have less.",
    )
    max_focal_ratio: float = limit(
        2.0,
        "Largest focal length of the search, over the longer side of the image.",
        chosen="By hand: 28 degrees of view; the cameras of phones and tablets have more.",
    )
    candidates: int = limit(
        13,
        "Focal lengths that the search tries, evenly spaced in their logarithm.",
        chosen="By hand: half a step moves a point at the border by 6 % of its distance to the centre.",
    )
    rough_error_ratio: float = limit(
        1.7,
        "Inlier limit of the search over the inlier limit of the final pose.",
        chosen="By hand: a candidate has an error of up to half a step.",
    )
    rough_iterations: int = limit(
        1500,
        "Largest number of RANSAC samples for each candidate.",
        chosen="By hand: the candidates only have to be compared.",
    )
    band_error_ratio: float = limit(
        1.5,
        "Inlier limit near a focal length from tags over the inlier limit of the final pose.",
        chosen="By hand: the steps there are smaller than those of the search.",
    )
    tag_sigma_ratio: float = limit(
        0.05,
        "Relative standard deviation of a focal length from a photo's tags or from the list of phones.",
        chosen="By hand: makers round to whole millimetres and measure along different sides.",
    )
    band_low_ratio: float = limit(
        0.85,
        "Lower end of the band around a focal length from tags, relative to it.",
        chosen="By hand: three standard deviations.",
    )
    band_high_ratio: float = limit(
        1.18,
        "Upper end of the band around a focal length from tags, relative to it.",
        chosen="By hand: about the inverse of the lower end.",
    )
    band_steps: tuple[float, ...] = limit(
        (1.0, 0.93, 1.07),
        "Focal lengths that are tried in the band, relative to the one from tags; the first one wins a tie.",
        chosen="By hand: with the larger inlier limit they cover the band.",
    )
    refined_range_steps: float = limit(
        1.5,
        "Half width of the range in which the best candidate is refined, in steps of the search.",
        chosen="By hand: the true focal length is within one step of the best candidate.",
    )
    pose_steps: int = limit(
        8,
        "Steps of refining the pose for each focal length that is tried, from the pose of the one before.",
        chosen="By hand: the focal lengths come closer and closer, so that the poses are nearly the same.",
    )
    log_tolerance: float = limit(
        1e-3,
        "Tolerance of the refined focal length's logarithm.",
        chosen="By hand: far below the error of the focal length.",
    )
    border_log: float = limit(
        0.01,
        "A refined focal length is rejected when its logarithm is nearer than this to the end of the range.",
        chosen="By hand: there the cost has no minimum inside the range.",
    )
    match_weight: float = limit(
        0.2,
        "Weight of one match in a robust cost, against a prior.",
        chosen="By measurement: with it the stated accuracies agree with the errors; command and figures were not "
        "kept. It is below 1 because matches are not independent: one feature is matched in several keyframes, and "
        "their points have the map's errors in common.",
    )
    max_error_px: float = limit(
        1e3,
        "Upper bound of a reprojection error in the cost.",
        chosen="By hand: keeps the cost of points behind the camera finite.",
    )


OPTIONS = FocalOptions()


@dataclass(frozen=True, slots=True)
class ApproximateCamera:
    """A pinhole camera whose focal length is only known approximately."""

    camera: Camera

    def covers(self, camera: Camera) -> bool:
        """Return whether a camera's focal length is in the band around this one's."""
        return OPTIONS.band_low_ratio <= camera.focal_px / self.camera.focal_px <= OPTIONS.band_high_ratio

    def log_bounds(self) -> tuple[float, float]:
        """Return the logarithms of the focal lengths in pixels at both ends of the band."""
        band = np.array([OPTIONS.band_low_ratio, OPTIONS.band_high_ratio])
        low, high = np.log(self.camera.focal_px * band)
        return float(low), float(high)


def focal_sigma_of(known: Camera | ApproximateCamera | None, found: Camera) -> float:
    """Return the relative standard deviation of a camera's focal length before it was estimated from matches.

    `known` is what was known then: 0 for a calibrated camera, infinity for nothing.
    """
    if isinstance(known, Camera):
        return 0.0
    return OPTIONS.tag_sigma_ratio if known is not None and known.covers(found) else float("inf")


def find_camera(
    points_px: Array,
    points_in_world: Array,
    width: int,
    height: int,
    max_error: float,
    min_inliers: int,
    near: ApproximateCamera | None = None,
) -> Camera | None:
    """Return the pinhole camera that fits matches best, near an approximate one if possible.

    Takes arguments and returns like `search_camera`, which is used without an approximate camera, and when the
    matches contradict it: too few inliers in its band, or the best focal length at the end of the band.
    """
    if near is not None:
        found = _near_camera(points_px, points_in_world, near, max_error, min_inliers)
        if found is not None:
            return found
    return search_camera(points_px, points_in_world, width, height, max_error, min_inliers)


def _near_camera(
    points_px: Array, points_in_world: Array, near: ApproximateCamera, max_error: float, min_inliers: int
) -> Camera | None:
    camera = near.camera
    size = camera.width, camera.height
    rough_error = OPTIONS.band_error_ratio * max_error
    in_band = camera.focal_px * np.array(OPTIONS.band_steps)
    best = _best_of(in_band, points_px, points_in_world, size, rough_error)
    if best is None or best[0] < min_inliers:
        return None
    focals = _candidates_px(size)
    low, high = camera.focal_px * OPTIONS.band_low_ratio, camera.focal_px * OPTIONS.band_high_ratio
    outside = focals[(focals < low) | (focals > high)]
    far = _best_of(outside, points_px, points_in_world, size, rough_error)
    # A wrong focal length has inliers too. It is recognized by another focal length that has more.
    if far is not None and far[0] > best[0]:
        return None
    _, _, pose, inliers = best
    sigma = OPTIONS.tag_sigma_ratio
    return _refined(points_px[inliers], points_in_world[inliers], camera, pose, near.log_bounds(), sigma)


def _candidates_px(size: tuple[int, int]) -> Array:
    """Return the focal lengths (k,) in pixels that are searched for an image of `size` (width, height)."""
    ratios = np.geomspace(OPTIONS.min_focal_ratio, OPTIONS.max_focal_ratio, OPTIONS.candidates)
    return np.asarray(ratios * max(size))


def _best_of(
    focals_px: Array, points_px: Array, points_in_world: Array, size: tuple[int, int], max_error: float
) -> tuple[int, Camera, Pose, NDArray[np.bool_]] | None:
    """Return inlier count, camera, pose and inliers (n,) of the focal length that has most inliers.

    The image has `size` (width, height); `max_error` is the inlier limit over the focal length.
    """
    cameras = pinholes(*size, focals_px)
    limits_px = [max_error * focal_px for focal_px in focals_px]
    found = estimate_poses_lo_ransac(
        points_px,
        points_in_world,
        list(zip(cameras, limits_px, strict=True)),
        max_iterations=OPTIONS.rough_iterations,
    )
    tried = [
        (int(each.inlier_mask.sum()), camera, each.world_from_camera, each.inlier_mask)
        for camera, each in zip(cameras, found, strict=True)
        if each is not None
    ]
    return max(tried, key=lambda each: each[0], default=None)


def pinhole(width: int, height: int, focal_px: float) -> Camera:
    """Return the pinhole camera with a focal length and its principal point at the image's centre."""
    return pinholes(width, height, [focal_px])[0]


def pinholes(width: int, height: int, focals_px: Iterable[float]) -> list[Camera]:
    """Return the pinhole camera of each focal length, as `pinhole` does."""
    centre = 0.5 * (width - 1), 0.5 * (height - 1)
    return [Camera("PINHOLE", width, height, (float(f), float(f), *centre)) for f in focals_px]


def search_camera(
    points_px: Array, points_in_world: Array, width: int, height: int, max_error: float, min_inliers: int
) -> Camera | None:
    """Return the pinhole camera, its principal point at the centre, with the focal length that fits best, or None.

    Pixels (n, 2) and world points (n, 3) may contain outliers; `max_error` is the inlier limit over the focal
    length. A short RANSAC is run for each of `OPTIONS.candidates` focal lengths; the one with most inliers is refined
    by `refine_camera`. None with fewer than `min_inliers`.
    """
    size = width, height
    rough_error = OPTIONS.rough_error_ratio * max_error
    best = _best_of(_candidates_px(size), points_px, points_in_world, size, rough_error)
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
    """Return the pinhole camera, near a given one, whose refined pose has the least robust reprojection error.

    Takes the inliers of `pose`: pixels (n, 2), world points (n, 3). The principal point is at the centre. An
    approximate camera is a prior on the focal length if `camera` is in its band. None when the best focal length is
    at the end of the range that is searched, where the cost has no minimum.
    """
    if near is not None and near.covers(camera):
        sigma = OPTIONS.tag_sigma_ratio
        return _refined(points_px, points_in_world, near.camera, pose, near.log_bounds(), sigma)
    exponent = OPTIONS.refined_range_steps / (OPTIONS.candidates - 1)
    step = (OPTIONS.max_focal_ratio / OPTIONS.min_focal_ratio) ** exponent
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

    `sigma` is the standard deviation of a normal prior on the logarithm, around the given camera's.
    """
    known, refined = float(np.log(camera.focal_px)), pose

    def cost(log_focal: float) -> float:
        # The focal lengths that are tried come closer and closer: the last pose is a good start for the next one.
        nonlocal refined
        candidate = pinhole(camera.width, camera.height, float(np.exp(log_focal)))
        refined = refine_pose(
            pixels,
            points,
            candidate,
            refined,
            loss_scale_px=PIXEL_NOISE.loss_scale_px,
            max_steps=OPTIONS.pose_steps,
        )
        errors = np.minimum(reprojection_errors_px(pixels, points, candidate, refined), OPTIONS.max_error_px)
        prior = 0.0 if sigma is None else 0.5 * ((log_focal - known) / sigma) ** 2
        robust = float(np.log1p((errors / PIXEL_NOISE.loss_scale_px) ** 2).sum())
        return OPTIONS.match_weight * robust + prior

    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": OPTIONS.log_tolerance})
    if min(found.x - bounds[0], bounds[1] - found.x) < OPTIONS.border_log:
        return None
    return pinhole(camera.width, camera.height, float(np.exp(found.x)))
