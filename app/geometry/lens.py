"""One radial coefficient of a lens that is not calibrated, estimated from frames with depth or with a pose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.focal import OPTIONS as FOCAL
from app.geometry.reprojection import project_from_world, reprojection_jacobian
from app.geometry.se3 import Pose, perturbed, rotation_from_vector
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class LensOptions:
    """How a radial coefficient is fitted."""

    prior_sigma: float = limit(
        0.03,
        "Standard deviation of the radial coefficient of a lens that is not known; its mean is 0.",
        chosen="By hand; RedKitchen's scan shows -0.029 (docs/features.md, The lens).",
    )
    picture_sigma: float = limit(
        0.009,
        "Standard deviation of a radial coefficient that is fitted to the matches of one picture.",
        chosen="By measurement; the command and the figures were not kept.",
    )
    loss_scale_px: float = limit(
        1.0,
        "Reprojection error at which a match's weight falls to half (Cauchy loss).",
        chosen="By hand: about the noise of a good match.",
    )
    steps: int = limit(
        12,
        "Largest number of Gauss-Newton steps.",
        chosen="By hand: meant to be enough to converge.",
    )
    slice_pairs: int = limit(
        16,
        "Pairs of frames that are taken together in a step, by one thread.",
        chosen="By hand: some hundredths of a second, so that several threads have their part.",
    )
    min_step: float = limit(
        1e-5,
        "A fit ends when a step changes no unknown by more than this.",
        chosen="By hand: far below the error of the coefficient.",
    )
    same_focal_ratio: float = limit(
        1e-3,
        "Focal lengths with at most this relative difference are those of one camera.",
        chosen="By hand: allows for rounded intrinsics.",
    )
    difference_step: float = limit(
        1e-4,
        "Step of the coefficient in the finite differences by it.",
        chosen="By hand: between the rounding error and the curvature.",
    )
    min_points: int = limit(
        4,
        "A lens is fitted to at least this number of points in front of the camera.",
        chosen="By hand: eight equations for eight unknowns.",
    )


OPTIONS = LensOptions()
LENS_SIGMA = OPTIONS.prior_sigma


@dataclass(frozen=True, slots=True)
class Lens:
    """A radial coefficient k1 (COLMAP's SIMPLE_RADIAL) and its standard deviation `sigma`."""

    coefficient: float = 0.0
    sigma: float = LENS_SIGMA

    def of(self, camera: Camera) -> Camera:
        """Return a camera with the pinhole intrinsics of `camera` and this lens."""
        if self.coefficient == 0.0:
            return Camera("PINHOLE", camera.width, camera.height, camera.params[:4])
        values = (*camera.params[:4], self.coefficient, 0.0, 0.0, 0.0)
        return Camera("OPENCV", camera.width, camera.height, values)

    @property
    def is_guess(self) -> bool:
        """Whether a single picture determines the coefficient better than it is known."""
        return self.sigma > OPTIONS.picture_sigma

    def _changed(self) -> Lens:
        return Lens(self.coefficient + OPTIONS.difference_step, self.sigma)


def has_focal_of(one: Camera, other: Camera) -> bool:
    """Whether two cameras have the same focal length, and so may have the same lens.

    The focal lengths agree in pixels, as after cropping, or relative to the image's size, as after resampling. Radial
    distortion is the same after cropping, resampling, or rotation by a quarter turn.
    """
    a, b = np.sort(one.params[:2]), np.sort(other.params[:2])
    sizes = max(one.width, one.height), max(other.width, other.height)
    return bool(
        np.allclose(a, b, rtol=OPTIONS.same_focal_ratio, atol=0)
        or np.allclose(a / sizes[0], b / sizes[1], rtol=OPTIONS.same_focal_ratio, atol=0)
    )


@dataclass(frozen=True, slots=True)
class SharedPoints:
    """Points that two frames see: pixels (n, 2) and z-depths (n,) in metres in frame a, pixels (n, 2) in frame b, and
    an approximate relative pose."""

    pixels_a: Array
    depth_m: Array
    pixels_b: Array
    b_from_a: Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class PairTerms:
    """What a pair of frames adds to the equation of the coefficient once its pose is eliminated.

    `solved` (6, 2) is the step of the pose, negated, as a function of the coefficient's: derivative and constant part.
    `squares` is the weighted sum of squared errors, of `count` weights in all.
    """

    solved: Array
    information: float
    gradient: float
    squares: float
    count: float


# Calls a function with each of some slices and gives the results in their order, as `map` does.
RunSlices = Callable[[Callable[[slice], list[PairTerms]], list[slice]], Iterable[list[PairTerms]]]


def fit_lens(pairs: Sequence[SharedPoints], camera: Camera, run: RunSlices = map) -> Lens:
    """Return the lens that fits the points of all pairs of frames best.

    Minimizes the Cauchy losses of the reprojection errors of frame a's points in frame b (C eq. 4.2.1 with a lens),
    over the coefficient and the relative pose of each pair: Gauss-Newton with the poses eliminated (Schur
    complement). K is kept, for depth and colour were registered with it. The poses are unknowns, so that their errors
    don't change the coefficient. There is no second coefficient: it would fit the misalignment of depth and colour.
    `run` may take slices of the pairs in several threads; the lens is the same to the last bit.
    """
    poses = [pair.b_from_a for pair in pairs]
    slices = [
        slice(first, first + OPTIONS.slice_pairs) for first in range(0, len(pairs), OPTIONS.slice_pairs)
    ]
    lens, information, variance = Lens(0.0), 0.0, 1.0
    for _ in range(OPTIONS.steps):
        eliminate = partial(_eliminated, pairs, poses, camera, lens)
        terms = [each for of_slice in run(eliminate, slices) for each in of_slice]
        information, gradient = LENS_SIGMA**-2, lens.coefficient / LENS_SIGMA**2
        squares, count = 0.0, 0.0
        for each in terms:
            squares, count = squares + each.squares, count + each.count
            information += each.information
            gradient += each.gradient
        step = -gradient / information
        lens = Lens(lens.coefficient + step)
        poses = [
            _moved(pose, -(each.solved[:, 1] + each.solved[:, 0] * step))
            for pose, each in zip(poses, terms, strict=True)
        ]
        variance = squares / count if count else 1.0
        if abs(step) < OPTIONS.min_step:
            break
    return Lens(lens.coefficient, float(np.sqrt(variance / information)))


def _eliminated(
    pairs: Sequence[SharedPoints], poses: Sequence[Pose], camera: Camera, lens: Lens, rows: slice
) -> list[PairTerms]:
    terms = []
    for pair, pose in zip(pairs[rows], poses[rows], strict=True):
        by_lens, by_pose, error, weight = _of_pair(pair, pose, camera, lens)
        weighted = by_pose * weight[:, None]
        right = np.column_stack([weighted.T @ by_lens, weighted.T @ error])
        solved: Array = np.asarray(
            np.linalg.solve(weighted.T @ by_pose + 1e-9 * np.eye(6), right), np.float64
        )
        lens_pose = by_lens @ weighted
        terms.append(
            PairTerms(
                solved=solved,
                information=float(by_lens @ (weight * by_lens) - lens_pose @ solved[:, 0]),
                gradient=float(by_lens @ (weight * error) - lens_pose @ solved[:, 1]),
                squares=float(weight @ error**2),
                count=float(weight.sum()),
            )
        )
    return terms


def _of_pair(pair: SharedPoints, pose: Pose, camera: Camera, lens: Lens) -> tuple[Array, Array, Array, Array]:
    """Return the derivatives by lens (2n,) and pose (2n, 6), the errors (2n,) in pixels, and their weights (2n,)."""
    present = lens.of(camera)
    points = pose.apply(present.unproject(pair.pixels_a, pair.depth_m))
    error = present.project(points) - pair.pixels_b
    changed = lens._changed().of(camera)
    moved = changed.project(pose.apply(changed.unproject(pair.pixels_a, pair.depth_m)))
    by_lens = (moved - pair.pixels_b - error) / OPTIONS.difference_step
    _, by_point = present.projection_jacobian(points)
    by_pose = np.concatenate([np.cross(points[:, None, :], by_point), by_point], axis=2)
    seen = np.isfinite(error).all(axis=1) & np.isfinite(by_lens).all(axis=1)
    weight = np.repeat(_weights(error[seen]), 2)
    return by_lens[seen].reshape(-1), by_pose[seen].reshape(-1, 6), error[seen].reshape(-1), weight


def _moved(pose: Pose, step: Array) -> Pose:
    turn = rotation_from_vector(step[:3])
    return Pose(turn @ pose.rotation, turn @ pose.translation + step[3:])


@dataclass(frozen=True, slots=True)
class Focal:
    """A focal length in pixels; `sigma` is the standard deviation of its logarithm, infinite if it is not known."""

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
    """Return the camera, with a radial coefficient, that fits the inliers of a picture best.

    Takes pixels (n, 2) and world points (n, 3) with their camera and pose. Gauss-Newton on the Cauchy losses of the
    reprojection errors (C eq. 5.1.2), over the pose, the coefficient and the focal length; `known` and `focal` are
    priors, and a focal length with a sigma of 0 is kept. Raises `InvalidCameraError` for an impossible focal length,
    `DegenerateGeometryError` for too few points in front of the camera.
    """
    lens, pose = known, world_from_camera
    free = np.array([True] * 7 + [focal.sigma > 0])
    prior = np.array([1e-9] * 6 + [known.sigma**-2, focal.sigma**-2 if focal.sigma > 0 else 0.0])
    for _ in range(OPTIONS.steps):
        by_all, error = _of_picture(points_px, points_in_world, camera, pose, lens)
        weighted = by_all * np.repeat(FOCAL.match_weight * _weights(error), 2)[:, None]
        from_prior = np.array(
            [0.0] * 6 + [lens.coefficient - known.coefficient, np.log(camera.focal_px / focal.focal_px)]
        )
        normal = (weighted.T @ by_all + np.diag(prior))[np.ix_(free, free)]
        step = np.zeros(8)
        step[free] = -np.linalg.solve(normal, (weighted.T @ error.reshape(-1) + prior * from_prior)[free])
        lens, pose = Lens(lens.coefficient + float(step[6]), known.sigma), perturbed(pose, step[:6])
        camera = _zoomed(camera, float(np.exp(step[7])))
        if np.abs(step).max() < OPTIONS.min_step:
            break
    return lens.of(camera)


def _of_picture(
    points_px: Array, points_in_world: Array, camera: Camera, pose: Pose, lens: Lens
) -> tuple[Array, Array]:
    """Return the derivatives (2n, 8) by pose, lens and log focal length, and the errors (n, 2), of points in view."""
    present = lens.of(camera)
    projected, by_pose, _ = reprojection_jacobian(points_in_world, present, pose)
    changed = project_from_world(points_in_world, lens._changed().of(camera), pose)
    by_lens = (changed - projected) / OPTIONS.difference_step
    by_focal = projected - present.principal_point_px
    seen = np.isfinite(projected).all(axis=1) & np.isfinite(by_lens).all(axis=1)
    if np.count_nonzero(seen) < OPTIONS.min_points:
        raise DegenerateGeometryError(
            f"A lens needs at least {OPTIONS.min_points} points in front of the camera."
        )
    by_all = np.concatenate([by_pose, by_lens[:, :, None], by_focal[:, :, None]], axis=2)
    return by_all[seen].reshape(-1, 8), (projected - points_px)[seen]


def _zoomed(camera: Camera, factor: float) -> Camera:
    fx, fy, cx, cy = camera.params[:4]
    return Camera("PINHOLE", camera.width, camera.height, (fx * factor, fy * factor, cx, cy))


def _weights(error: Array) -> Array:
    """Return the weights (n,) of errors (n, 2) in a reweighted least-squares step (Cauchy loss)."""
    return np.asarray(1.0 / (1.0 + np.sum(error**2, axis=1) / OPTIONS.loss_scale_px**2))
