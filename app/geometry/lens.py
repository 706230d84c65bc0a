"""A lens that nobody calibrated: one radial coefficient, found from frames with depth, or together with a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.focal import MATCH_SAY
from app.geometry.reprojection import perturbed, project_from_world, reprojection_jacobian
from app.geometry.se3 import Pose, rotation_from_vector

Array = NDArray[np.float64]

# How far from a pinhole such a lens is taken to be, one sigma of its coefficient.
LENS_SIGMA = 0.03
# What one picture's matches leave open.
PICTURE_SIGMA = 0.009
# A match's say falls to half where it is off by this much.
LOSS_SCALE_PX = 1.0
STEPS, SMALLEST_STEP = 12, 1e-5
# Focal lengths that agree to so much are those of one camera.
SAME_FOCAL = 1e-3
DIFFERENCE = 1e-4
MIN_POINTS = 4


@dataclass(frozen=True, slots=True)
class Lens:
    """A radial coefficient k1 as far as it is known: COLMAP's SIMPLE_RADIAL, to within `sigma`."""

    coefficient: float = 0.0
    sigma: float = LENS_SIGMA

    def of(self, camera: Camera) -> Camera:
        """Return a camera's pinhole behind this lens."""
        if self.coefficient == 0.0:
            return Camera("PINHOLE", camera.width, camera.height, camera.params[:4])
        values = (*camera.params[:4], self.coefficient, 0.0, 0.0, 0.0)
        return Camera("OPENCV", camera.width, camera.height, values)

    @property
    def is_guess(self) -> bool:
        """Whether a single picture can tell more of it than is known."""
        return self.sigma > PICTURE_SIGMA

    def _changed(self) -> Lens:
        return Lens(self.coefficient + DIFFERENCE, self.sigma)


def has_focal_of(one: Camera, other: Camera) -> bool:
    """Whether focal lengths agree: in pixels, as in a cropped picture, or as a share of its size; a lens that bends
    by the distance from the axis alone is the same in a picture that is cropped, resampled or turned."""
    a, b = np.sort(one.params[:2]), np.sort(other.params[:2])
    sizes = max(one.width, one.height), max(other.width, other.height)
    return bool(
        np.allclose(a, b, rtol=SAME_FOCAL, atol=0)
        or np.allclose(a / sizes[0], b / sizes[1], rtol=SAME_FOCAL, atol=0)
    )


@dataclass(frozen=True, slots=True)
class SharedPoints:
    """Points that two frames see: pixels (n, 2) and z-depths (n,) in metres in frame a, pixels (n, 2) in frame b, and
    the pose of a in b's axes, about right."""

    pixels_a: Array
    depth_m: Array
    pixels_b: Array
    b_from_a: Pose


def fit_lens(pairs: Sequence[SharedPoints], camera: Camera) -> Lens:
    """Return the lens with which what all pairs share fits best.

    Minimizes the Cauchy losses of the distances in frame b between pixels and where frame a's points come to lie
    (C eq. 4.2.1 behind a lens), over the coefficient and the pose of each pair: Gauss-Newton, the poses eliminated
    (Schur complement). K stays: depth and colour were registered with it. Poses are free, so that their errors are
    not taken for the lens; a second coefficient fits what depth and colour are misaligned by.
    """
    poses = [pair.b_from_a for pair in pairs]
    lens, information, variance = Lens(0.0), 0.0, 1.0
    for _ in range(STEPS):
        information, gradient = LENS_SIGMA**-2, lens.coefficient / LENS_SIGMA**2
        along, squares, count = [], 0.0, 0.0
        for pair, pose in zip(pairs, poses, strict=True):
            by_lens, by_pose, error, weight = _of_pair(pair, pose, camera, lens)
            squares, count = squares + float(weight @ error**2), count + float(weight.sum())
            weighted = by_pose * weight[:, None]
            right = np.column_stack([weighted.T @ by_lens, weighted.T @ error])
            step_by = np.linalg.solve(weighted.T @ by_pose + 1e-9 * np.eye(6), right)
            along.append(step_by)
            across = by_lens @ weighted
            information += float(by_lens @ (weight * by_lens) - across @ step_by[:, 0])
            gradient += float(by_lens @ (weight * error) - across @ step_by[:, 1])
        step = -gradient / information
        lens = Lens(lens.coefficient + step)
        poses = [_moved(pose, -(by[:, 1] + by[:, 0] * step)) for pose, by in zip(poses, along, strict=True)]
        variance = squares / count if count else 1.0
        if abs(step) < SMALLEST_STEP:
            break
    return Lens(lens.coefficient, float(np.sqrt(variance / information)))


def _of_pair(pair: SharedPoints, pose: Pose, camera: Camera, lens: Lens) -> tuple[Array, Array, Array, Array]:
    """Return the derivatives by lens (2n,) and pose (2n, 6), the errors (2n,) in pixels, and their weights (2n,)."""
    here = lens.of(camera)
    points = pose.apply(here.unproject(pair.pixels_a, pair.depth_m))
    error = here.project(points) - pair.pixels_b
    changed = lens._changed().of(camera)
    moved = changed.project(pose.apply(changed.unproject(pair.pixels_a, pair.depth_m)))
    by_lens = (moved - pair.pixels_b - error) / DIFFERENCE
    by_point = here.projection_jacobian(points)
    by_pose = np.concatenate([np.cross(points[:, None, :], by_point), by_point], axis=2)
    seen = np.isfinite(error).all(axis=1) & np.isfinite(by_lens).all(axis=1)
    weight = np.repeat(_say(error[seen]), 2)
    return by_lens[seen].reshape(-1), by_pose[seen].reshape(-1, 6), error[seen].reshape(-1), weight


def _moved(pose: Pose, step: Array) -> Pose:
    turn = rotation_from_vector(step[:3])
    return Pose(turn @ pose.rotation, turn @ pose.translation + step[3:])


@dataclass(frozen=True, slots=True)
class Focal:
    """A focal length in pixels as far as it is known: `sigma` is of its logarithm, infinite where it is not."""

    focal_px: float
    sigma: float = 0.0


def refine_lens(
    points_px: Array,
    points_in_world: Array,
    camera: Camera,
    world_from_camera: Pose,
    known: Lens,
    focal: Focal,
) -> Camera:
    """Return the camera that fits a picture's inliers best, their pose free: pixels (n, 2), world points (n, 3).

    Gauss-Newton on the Cauchy losses of the reprojection errors (C eq. 5.1.2), the known lens and focal length as
    priors; a focal length with a sigma of 0 stays. Raises `InvalidCameraError` for a focal length of no camera,
    `DegenerateGeometryError` for too few points in front of the camera.
    """
    lens, pose = known, world_from_camera
    free = np.array([True] * 7 + [focal.sigma > 0])
    prior = np.array([1e-9] * 6 + [known.sigma**-2, focal.sigma**-2 if focal.sigma > 0 else 0.0])
    for _ in range(STEPS):
        by_all, error = _of_picture(points_px, points_in_world, camera, pose, lens)
        weighted = by_all * np.repeat(MATCH_SAY * _say(error), 2)[:, None]
        off = np.array(
            [0.0] * 6 + [lens.coefficient - known.coefficient, np.log(camera.focal_px / focal.focal_px)]
        )
        normal = (weighted.T @ by_all + np.diag(prior))[np.ix_(free, free)]
        step = np.zeros(8)
        step[free] = -np.linalg.solve(normal, (weighted.T @ error.reshape(-1) + prior * off)[free])
        lens, pose = Lens(lens.coefficient + float(step[6]), known.sigma), perturbed(pose, step[:6])
        camera = _zoomed(camera, float(np.exp(step[7])))
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return lens.of(camera)


def _of_picture(
    points_px: Array, points_in_world: Array, camera: Camera, pose: Pose, lens: Lens
) -> tuple[Array, Array]:
    """Return the derivatives (2n, 8) by pose, lens and log focal length, and the errors (n, 2), of points in view."""
    here = lens.of(camera)
    projected = project_from_world(points_in_world, here, pose)
    by_pose, _ = reprojection_jacobian(points_in_world, here, pose)
    changed = project_from_world(points_in_world, lens._changed().of(camera), pose)
    by_lens, by_focal = (changed - projected) / DIFFERENCE, projected - here.principal_point_px
    seen = np.isfinite(projected).all(axis=1) & np.isfinite(by_lens).all(axis=1)
    if np.count_nonzero(seen) < MIN_POINTS:
        raise DegenerateGeometryError(f"A lens needs at least {MIN_POINTS} points in front of the camera.")
    by_all = np.concatenate([by_pose, by_lens[:, :, None], by_focal[:, :, None]], axis=2)
    return by_all[seen].reshape(-1, 8), (projected - points_px)[seen]


def _zoomed(camera: Camera, factor: float) -> Camera:
    fx, fy, cx, cy = camera.params[:4]
    return Camera("PINHOLE", camera.width, camera.height, (fx * factor, fy * factor, cx, cy))


def _say(error: Array) -> Array:
    """Return the weights (n,) of errors (n, 2) in a reweighted least-squares step."""
    return np.asarray(1.0 / (1.0 + np.sum(error**2, axis=1) / LOSS_SCALE_PX**2))
