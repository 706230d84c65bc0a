"""The pose of least reprojection error near a given one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.camera import Camera
from app.geometry.reprojection import PIXEL_NOISE, ReprojectionCost, reprojection_errors_px
from app.geometry.se3 import Pose, perturbed
from app.geometry.validation import finite_pairs
from app.limits import limit

Array = NDArray[np.float64]
Loss = Literal["cauchy", "trivial"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseRefinementOptions:
    """The Levenberg-Marquardt steps of a pose."""

    refinement_steps: int = limit(
        30,
        "Largest number of Levenberg-Marquardt steps, rejected ones included.",
        chosen="By hand: meant to be enough to converge.",
    )
    behind_camera_px: float = limit(
        1e4,
        "Residual of a point behind the camera.",
        chosen="By hand: more than any reprojection error, and finite so that the costs of steps can be compared.",
    )
    min_step: float = limit(
        1e-8,
        "The refinement ends when a step is smaller than this, in metres and radians.",
        chosen="By hand: far below the error of a pose.",
    )
    min_gain_ratio: float = limit(
        1e-10,
        "The refinement ends when a step lowers the cost by at most this ratio.",
        chosen="By hand: near the rounding error.",
    )
    initial_damping: float = limit(
        1e-4,
        "Damping of the first step, relative to the diagonal of the normal equations.",
        chosen="By hand: nearly a Gauss-Newton step.",
    )
    min_damping: float = limit(
        1e-10,
        "Lower bound of the damping.",
        chosen="By hand: no damping, up to rounding.",
    )
    max_damping: float = limit(
        1e8,
        "The refinement ends when no step up to this damping lowers the cost.",
        chosen="By hand: such a step moves nothing.",
    )


OPTIONS = PoseRefinementOptions()


def refine_pose(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    world_from_camera: Pose,
    *,
    loss: Loss = "cauchy",
    loss_scale_px: float = PIXEL_NOISE.loss_scale_px,
    weights: ArrayLike | None = None,
    max_steps: int = OPTIONS.refinement_steps,
) -> Pose:
    """Return the `world_from_camera` of least reprojection error near the given one.

    Minimizes the sum over pixels (n, 2) and world points (n, 3) of `weights` (n,) times the loss of the squared
    error: 'trivial' is the squared error itself (A eq. 11, C eq. 5.1.2), 'cauchy' grows only logarithmically beyond
    `loss_scale_px`. Levenberg-Marquardt with the analytic Jacobian. Raises `DegenerateGeometryError` for fewer than
    three points in front of the camera, `InvalidInputError` for numbers that are not finite or weights below zero.
    """
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    factors = np.ones(len(pixels)) if weights is None else _checked_weights(weights, len(pixels))
    errors = reprojection_errors_px(pixels, points, camera, world_from_camera)
    if np.count_nonzero(np.isfinite(errors) & (factors > 0)) < 3:
        raise DegenerateGeometryError("A pose needs at least three points in front of the camera.")
    cost = ReprojectionCost(
        points_px=pixels,
        points_in_world=points,
        camera=camera,
        weights=factors,
        scale_px=loss_scale_px if loss == "cauchy" else np.inf,
        max_error_px=OPTIONS.behind_camera_px,
    )
    return minimized(world_from_camera, cost.around, max_steps)


def _checked_weights(weights: ArrayLike, count: int) -> Array:
    factors = np.asarray(weights, dtype=np.float64)
    if factors.shape != (count,) or not np.isfinite(factors).all() or (factors < 0).any():
        raise InvalidInputError(f"Weights must be {count} finite numbers that are not negative.")
    return factors


def minimized(pose: Pose, around: Callable[[Pose], tuple[float, Array, Array]], max_steps: int) -> Pose:
    """Return the pose of least cost near the given one, by Levenberg-Marquardt.

    `around` returns the cost of a pose, and the gradient (6,) and the approximate Hessian (6, 6) of half of it by the
    perturbation of `perturbed`: nearly all steps are accepted, so that they are needed nearly always.
    """
    damping = OPTIONS.initial_damping
    cost, gradient, hessian = around(pose)
    for _ in range(max_steps):
        # Damping relative to the diagonal doesn't depend on the units. The lower bound keeps the matrix
        # invertible when the points don't determine a direction.
        diagonal = np.diag(hessian)
        damped = hessian + np.diag(damping * diagonal + 1e-12 * diagonal.max() + 1e-300)
        step = -np.linalg.solve(damped, gradient)
        candidate = perturbed(pose, step)
        candidate_cost, *equations = around(candidate)
        if candidate_cost > cost:
            damping *= 10.0
            if damping > OPTIONS.max_damping:
                break
            continue
        gain, pose, cost = cost - candidate_cost, candidate, candidate_cost
        if gain <= OPTIONS.min_gain_ratio * cost or float(np.abs(step).max()) < OPTIONS.min_step:
            break
        damping = max(damping * 0.1, OPTIONS.min_damping)
        gradient, hessian = equations
    return pose
