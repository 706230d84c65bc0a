"""Bundle adjustment: the poses of a few views of one camera, and the points, of least reprojection error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.reprojection import PIXEL_NOISE
from app.geometry.se3 import Pose, perturbed
from app.limits import limit

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleOptions:
    """The Levenberg-Marquardt steps of a bundle adjustment."""

    max_steps: int = limit(
        8,
        "Steps of a bundle adjustment, rejected ones included.",
        chosen="By hand: tracking starts near the minimum.",
    )
    min_gain_ratio: float = limit(
        1e-4,
        "The adjustment ends when a step lowers the cost by less than this ratio.",
        chosen="By hand: a smaller gain changes the poses by far less than their noise.",
    )
    behind_camera_px: float = limit(
        1e3,
        "Residual of a point behind its camera.",
        chosen="By hand: more than any reprojection error, and finite so that the costs of steps can be compared.",
    )
    initial_damping: float = limit(
        1e-4,
        "Damping of the first step, relative to the diagonal of the normal equations.",
        chosen="By hand: nearly a Gauss-Newton step.",
    )
    min_damping: float = limit(
        1e-8,
        "Lower bound of the damping.",
        chosen="By hand: no damping, up to rounding.",
    )
    max_damping: float = limit(
        1e4,
        "The adjustment ends when no step up to this damping lowers the cost.",
        chosen="By hand: such a step hardly moves anything.",
    )


OPTIONS = BundleOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """Observations of points by views.

    Observation i is `pixels[i]` (m, 2) of point `rows[i]` (m,) in view `views[i]` (m,); no pair of point and view
    occurs twice. `is_fixed` (k,) marks views whose poses are kept. `prior` (p, 3) are the known positions of points
    in world metres, `prior_sigma_m` (p,) their standard deviations, infinite for points that are not known.
    `has_lens` (k,) marks the views that were taken through the lens of `camera`, by default all; the pixels of the
    other views must have been converted to this camera.
    """

    camera: Camera
    views: Rows
    rows: Rows
    pixels: Array
    is_fixed: NDArray[np.bool_]
    prior: Array
    prior_sigma_m: Array
    has_lens: NDArray[np.bool_] | None = None


def adjust_bundle(
    bundle: Bundle,
    poses: Sequence[Pose],
    points_in_world: Array,
    max_steps: int = OPTIONS.max_steps,
) -> tuple[list[Pose], Array]:
    """Return the `world_from_camera` of all views and the points (p, 3) of least reprojection error.

    Minimizes the sum of the Cauchy losses of the reprojection errors and of the squared distances from the priors,
    each divided by its standard deviation: C eq. 5.1.2 summed over several frames, with the points as unknowns.
    Levenberg-Marquardt with the points eliminated (Schur complement). Without priors at least two views must be
    fixed; otherwise the scale is undetermined. Source: Triggs et al., Bundle Adjustment, section 6.1.
    """
    problem = _Problem(bundle)
    state = list(poses), np.array(points_in_world, dtype=np.float64)
    cost, damping = problem.cost(*state), OPTIONS.initial_damping
    equations = problem.equations(*state)
    for _ in range(max_steps):
        step = equations.solve(damping)
        candidate = problem.moved(*state, *step)
        candidate_cost = problem.cost(*candidate)
        if not candidate_cost < cost:
            damping *= 10.0
            if damping > OPTIONS.max_damping:
                break
            continue
        gain, state, cost = cost - candidate_cost, candidate, candidate_cost
        if gain < OPTIONS.min_gain_ratio * cost:
            break
        damping = max(0.1 * damping, OPTIONS.min_damping)
        equations = problem.equations(*state)
    return state


def lens_in_bundle(
    bundle: Bundle,
    poses: Sequence[Pose],
    points_in_world: Array,
) -> tuple[float, float]:
    """Return the change of the camera's radial coefficient k1 that fits an adjusted bundle best, and its information.

    One Gauss-Newton step for k1, with poses and points as further unknowns that are eliminated. The information is
    the inverse of the variance of k1. Only for a camera whose distortion is k1 alone.
    """
    problem, state = _Problem(bundle), (list(poses), np.asarray(points_in_world))
    equations = problem.equations(*state)
    by_lens = problem.by_lens(*state)
    # The change of poses and points with k1: their equations, solved with the lens's column as the gradient.
    pose_steps, point_steps = replace(
        equations, pose_gradient=by_lens.poses, point_gradient=by_lens.points
    ).solve(1e-6)
    information = by_lens.own + float(
        np.sum(by_lens.poses * pose_steps) + np.sum(by_lens.points * point_steps)
    )
    gradient = by_lens.gradient + float(
        np.sum(equations.pose_gradient * pose_steps) + np.sum(equations.point_gradient * point_steps)
    )
    return -gradient / max(information, 1e-12), max(information, 0.0)


@dataclass(frozen=True, slots=True)
class _ByLens:
    """The lens's column of the normal equations, with poses (k, 6), points (p, 3) and itself, and its gradient."""

    poses: Array
    points: Array
    own: float
    gradient: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Equations:
    """Normal equations in blocks: poses (k, 6, 6), points (p, 3, 3), and points with poses (p, k, 6, 3)."""

    poses: Array
    points: Array
    between: Array
    pose_gradient: Array
    point_gradient: Array
    is_fixed: NDArray[np.bool_]

    def solve(self, damping: float) -> tuple[Array, Array]:
        """Return the steps of the poses (k, 6) and of the points (p, 3)."""
        points = _damped(self.points, damping)
        inverse = np.linalg.inv(points)
        k, p = len(self.poses), len(points)
        left = (self.between @ inverse[:, None]).transpose(1, 2, 0, 3).reshape(6 * k, 3 * p)
        right = self.between.transpose(1, 2, 0, 3).reshape(6 * k, 3 * p)
        reduced = -left @ right.T
        blocks = _damped(self.poses, damping)
        for i in range(k):
            reduced[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += blocks[i]
        gradient = self.pose_gradient.reshape(-1) - left @ self.point_gradient.reshape(-1)
        free = np.repeat(~self.is_fixed, 6)
        pose_steps = np.zeros(6 * k)
        pose_steps[free] = -np.linalg.solve(reduced[np.ix_(free, free)], gradient[free])
        rest = self.point_gradient.reshape(-1) + right.T @ pose_steps
        point_steps = -(inverse @ rest.reshape(p, 3, 1))[:, :, 0]
        return pose_steps.reshape(k, 6), point_steps


def _damped(blocks: Array, damping: float) -> Array:
    diagonal = np.einsum("nii->ni", blocks)
    floor = 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
    return np.asarray(blocks + np.eye(blocks.shape[1]) * (damping * diagonal + floor)[:, :, None])


@dataclass(frozen=True, slots=True)
class _Problem:
    bundle: Bundle

    def cost(self, poses: list[Pose], points: Array) -> float:
        errors = np.sum(self._residuals(poses, points)[0] ** 2, axis=1)
        scale = (PIXEL_NOISE.loss_scale_px / PIXEL_NOISE.sigma_px) ** 2
        away = (points - self.bundle.prior) / self.bundle.prior_sigma_m[:, None]
        return float(scale * np.sum(np.log1p(errors / scale)) + np.sum(away**2))

    def moved(
        self, poses: list[Pose], points: Array, pose_steps: Array, point_steps: Array
    ) -> tuple[list[Pose], Array]:
        moved = [
            pose if fixed else perturbed(pose, step)
            for pose, step, fixed in zip(poses, pose_steps, self.bundle.is_fixed, strict=True)
        ]
        return moved, points + point_steps

    def _residuals(self, poses: list[Pose], points: Array) -> tuple[Array, Array, Array, Array]:
        """Return residuals (m, 2) in standard deviations, the points in camera axes (m, 3), the rotations (m, 3, 3) of
        the views, and the points minus the camera centres (m, 3)."""
        bundle = self.bundle
        rotations = np.stack([pose.rotation for pose in poses])[bundle.views]
        centres = np.stack([pose.translation for pose in poses])[bundle.views]
        offsets = points[bundle.rows] - centres
        in_camera = np.einsum("mji,mj->mi", rotations, offsets)
        residuals = (bundle.camera.project(in_camera) - bundle.pixels) / PIXEL_NOISE.sigma_px
        return (
            np.where(np.isfinite(residuals), residuals, OPTIONS.behind_camera_px / PIXEL_NOISE.sigma_px),
            in_camera,
            rotations,
            offsets,
        )

    def _linearized(self, poses: list[Pose], points: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return residuals (m, 2), points in camera axes (m, 3), derivatives by pose (m, 2, 6) and by point (m, 2, 3),
        and weights (m,)."""
        residuals, in_camera, rotations, offsets = self._residuals(poses, points)
        _, by_point = self.bundle.camera.projection_jacobian(in_camera)
        by_point = by_point @ rotations.transpose(0, 2, 1) / PIXEL_NOISE.sigma_px
        by_point[~np.isfinite(by_point).all(axis=(1, 2))] = 0.0
        by_pose = np.concatenate([np.cross(by_point, offsets[:, None, :]), -by_point], axis=2)
        scale = (PIXEL_NOISE.loss_scale_px / PIXEL_NOISE.sigma_px) ** 2
        return residuals, in_camera, by_pose, by_point, 1.0 / (1.0 + np.sum(residuals**2, axis=1) / scale)

    def by_lens(self, poses: list[Pose], points: Array) -> _ByLens:
        bundle = self.bundle
        residuals, in_camera, by_pose, by_point, weights = self._linearized(poses, points)
        plane = in_camera[:, :2] / np.maximum(in_camera[:, 2:], 1e-9)
        focal = np.array(bundle.camera.params[:2]) / PIXEL_NOISE.sigma_px
        column = focal * plane * np.sum(plane**2, axis=1)[:, None] * weights[:, None]
        # Points that are out of view have no influence, as in `equations`.
        column[~by_point.any(axis=(1, 2))] = 0.0
        if bundle.has_lens is not None:
            column[~bundle.has_lens[bundle.views]] = 0.0
        return _ByLens(
            poses=_summed(np.einsum("mij,mi->mj", by_pose, column), bundle.views, len(poses)),
            points=_summed(np.einsum("mij,mi->mj", by_point, column), bundle.rows, len(points)),
            own=float(np.sum(column**2 / np.maximum(weights, 1e-12)[:, None])),
            gradient=float(np.sum(column * residuals)),
        )

    def equations(self, poses: list[Pose], points: Array) -> _Equations:
        bundle = self.bundle
        k, p = len(poses), len(points)
        residuals, _, by_pose, by_point, weights = self._linearized(poses, points)
        pose_t = by_pose.transpose(0, 2, 1) * weights[:, None, None]
        point_t = by_point.transpose(0, 2, 1) * weights[:, None, None]
        information = 1.0 / bundle.prior_sigma_m**2
        points_block = _summed(point_t @ by_point, bundle.rows, p) + information[:, None, None] * np.eye(3)
        between = np.zeros((p, k, 6, 3))
        between[bundle.rows, bundle.views] = pose_t @ by_point
        between[:, bundle.is_fixed] = 0.0
        away = points - bundle.prior
        by_points = _summed((point_t @ residuals[:, :, None])[:, :, 0], bundle.rows, p)
        return _Equations(
            poses=_summed(pose_t @ by_pose, bundle.views, k),
            points=points_block,
            between=between,
            pose_gradient=_summed((pose_t @ residuals[:, :, None])[:, :, 0], bundle.views, k),
            point_gradient=by_points + information[:, None] * away,
            is_fixed=bundle.is_fixed,
        )


def _summed(values: Array, rows: Rows, count: int) -> Array:
    """Return the sums of values (m, ...) by row, (count, ...)."""
    flat = values.reshape(len(values), -1)
    sums = np.stack([np.bincount(rows, flat[:, i], count) for i in range(flat.shape[1])], axis=1)
    return np.asarray(sums.reshape(count, *values.shape[1:]))
