"""Whether the matches of a picture fit the intrinsics that were stated for it, or others far better."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.focal import OPTIONS as FOCAL
from app.geometry.reprojection import PIXEL_NOISE
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]

# Nine unknowns need five points; with this many a few outliers do no harm.
MIN_POINTS = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class IntrinsicsOptions:
    """How stated intrinsics are compared with those that the matches fit best."""

    max_points: int = limit(300, "Most inliers that the fit is made of.", chosen="By hand: for speed.")
    steps: int = limit(8, "Largest number of Gauss-Newton steps.", chosen="By hand: it converges in four.")
    min_step: float = limit(1e-5, "A smaller step ends the iteration.", chosen="By hand: far below a pixel.")
    prior_log_focal_sigma: float = limit(
        0.3,
        "Standard deviation of the prior on the logarithm of the focal length.",
        chosen="By hand: a picture that leaves the focal length open keeps the stated one; a zoom of two that matches "
        "determine to a percent is moved by less than that.",
    )
    prior_offset_share: float = limit(
        0.04,
        "Standard deviation of the prior on the principal point's offset, over the longer side of the image.",
        chosen="By hand: more than stabilisation moves it.",
    )
    square_log: float = limit(
        0.03,
        "Logarithm of fx over fy from which on the pixels may be square after all.",
        chosen="By hand: calibrations differ by 1 %, pictures that were stretched by a third.",
    )


OPTIONS = IntrinsicsOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeIntrinsics:
    """The intrinsics that a picture's matches fit best, as changes of the stated ones.

    `log_focal` is the logarithm of the ratio of focal lengths, `offset_px` (2,) how far the principal point moves;
    `focal_sigma` and `offset_sigmas_px` (2,) are their standard deviations by the matches alone; that of the
    logarithm is the relative one of the focal length.
    """

    camera: Camera
    pose: Pose
    log_focal: float
    offset_px: Array
    focal_sigma: float
    offset_sigmas_px: Array


def free_intrinsics(
    points_px: Array,
    points_in_world: Array,
    camera: Camera,
    world_from_camera: Pose,
    *,
    keep_centre: bool = False,
) -> FreeIntrinsics | None:
    """Return the intrinsics that the inliers of a pose fit best: pixels (n, 2), world points (n, 3), of which every
    second, third, ... is taken where there are many.

    Gauss-Newton on the Cauchy losses of the reprojection errors over pose, focal length and principal point, from the
    stated camera and its pose; the lens is kept, and with `keep_centre` the principal point. None where they determine
    no camera.
    """
    every = max(1, -(-len(points_px) // OPTIONS.max_points))
    points_px, points_in_world = points_px[::every], points_in_world[::every]
    if len(points_px) < MIN_POINTS:
        return None
    offset_sigma_px = 1e-6 if keep_centre else OPTIONS.prior_offset_share * max(camera.width, camera.height)
    prior = np.array([1e-9] * 6 + [OPTIONS.prior_log_focal_sigma**-2] + [offset_sigma_px**-2] * 2)
    camera_from_world, view = world_from_camera.inverse(), (camera.model, camera.K, camera.distortion)
    turn = cv2.Rodrigues(camera_from_world.rotation)[0][:, 0]
    unknowns = np.concatenate([turn, camera_from_world.translation, np.zeros(3)])
    points = np.ascontiguousarray(points_in_world, dtype=np.float64)
    free, normal = np.r_[np.zeros(6), np.ones(3)], np.eye(9)
    for _ in range(OPTIONS.steps):
        projected, by_all = _linearised(points, unknowns, *view)
        error = projected - points_px
        weights = 1.0 / (1.0 + (np.linalg.norm(error, axis=1) / PIXEL_NOISE.loss_scale_px) ** 2)
        weighted = by_all * np.repeat(FOCAL.match_weight * weights, 2)[:, None]
        normal = weighted.T @ by_all + np.diag(prior)
        try:
            step = -np.linalg.solve(normal, weighted.T @ error.reshape(-1) + prior * free * unknowns)
        except np.linalg.LinAlgError:
            return None
        unknowns = unknowns + step
        if not np.isfinite(unknowns).all():
            return None
        if np.abs(step[:7]).max() < OPTIONS.min_step:
            break
    try:
        found = changed_camera(camera, unknowns[6:])
    except InvalidCameraError:
        return None
    pose = Pose(np.asarray(cv2.Rodrigues(unknowns[:3])[0], dtype=np.float64), unknowns[3:6]).inverse()
    sigmas = np.sqrt(np.diag(np.linalg.inv(normal))[6:])
    return FreeIntrinsics(
        camera=found,
        pose=pose,
        log_focal=float(unknowns[6]),
        offset_px=unknowns[7:],
        focal_sigma=float(sigmas[0]),
        offset_sigmas_px=sigmas[1:],
    )


def _linearised(
    points: Array, unknowns: Array, model: str, K: Array, distortion: Array
) -> tuple[Array, Array]:
    """Return the pixels (n, 2) of world points (n, 3) and their derivatives (2n, 9) by the unknowns (9,).

    The unknowns are the rotation vector and the translation of `camera_from_world`, the logarithm of the change of the
    focal length, and the change of the principal point in pixels.
    """
    turn, translation, zoom = unknowns[:3], unknowns[3:6], float(np.exp(unknowns[6]))
    changed = K * np.array([[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]])
    changed[:2, 2] += unknowns[7:]
    if model == "OPENCV_FISHEYE":
        pixels, by_all = cv2.fisheye.projectPoints(points[:, None], turn, translation, changed, distortion)
        by_focal, by_centre, by_pose = by_all[:, :2], by_all[:, 2:4], by_all[:, 8:14]
    else:
        pixels, by_all = cv2.projectPoints(points, turn, translation, changed, distortion)
        by_pose, by_focal, by_centre = by_all[:, :6], by_all[:, 6:8], by_all[:, 8:10]
    by_log_focal = by_focal @ np.diag(changed)[:2]
    derivatives = np.concatenate([by_pose, by_log_focal[:, None], by_centre], axis=1)
    return np.asarray(pixels.reshape(-1, 2), dtype=np.float64), derivatives


def square_pixels(camera: Camera) -> list[Camera]:
    """Return cameras with one focal length for both axes, either of the stated two, where these are far apart."""
    fx, fy, *rest = camera.params
    if abs(np.log(fx / fy)) <= OPTIONS.square_log:
        return []
    cameras = []
    for focal_px in (fx, fy):
        try:
            cameras.append(Camera(camera.model, camera.width, camera.height, (focal_px, focal_px, *rest)))
        except InvalidCameraError:
            continue
    return cameras


def changed_camera(camera: Camera, change: ArrayLike) -> Camera:
    """Return a camera with the logarithm of its focal length and its principal point (pixels) changed by (3,)."""
    change = np.asarray(change, dtype=np.float64)
    fx, fy, cx, cy, *lens = camera.params
    zoom = float(np.exp(change[0]))
    params = (fx * zoom, fy * zoom, cx + float(change[1]), cy + float(change[2]), *lens)
    return Camera(camera.model, camera.width, camera.height, params)


def zoomed_cameras(camera: Camera, zooms: Sequence[float]) -> list[Camera]:
    """Return the cameras whose focal lengths are those of a camera times each zoom, where a lens can have them."""
    fx, fy, *rest = camera.params
    found = []
    for zoom in zooms:
        with suppress(InvalidCameraError):
            found.append(Camera(camera.model, camera.width, camera.height, (fx * zoom, fy * zoom, *rest)))
    return found
