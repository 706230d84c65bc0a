"""The covariance of a relative pose that was fitted to matches, by first-order error propagation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.covariance import OPTIONS as COVARIANCE
from app.geometry.covariance import SIGMA_PER_MAD
from app.geometry.epipolar import essential_from_pose
from app.geometry.sampson import sampson_slopes
from app.geometry.se3 import Pose, rotation_from_vector
from app.geometry.triangulation import homogeneous
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeCovarianceOptions:
    """How the derivatives of the Sampson errors are computed."""

    difference_step_rad: float = limit(
        1e-6,
        "Step of the finite differences.",
        chosen="By hand: between the rounding error and the curvature.",
    )


OPTIONS = RelativeCovarianceOptions()


def perturbed_relative(b_from_a: Pose, change: Array) -> Pose:
    """Return the relative pose after a change (5,) in radians.

    The first three are a rotation vector, applied on the left; the last two rotate the translation about two axes
    perpendicular to it, which keeps its length.
    """
    t = b_from_a.translation
    axes = np.linalg.svd(t[None])[2][1:]
    turn = rotation_from_vector(change[3] * axes[0] + change[4] * axes[1])
    return Pose(rotation_from_vector(change[:3]) @ b_from_a.rotation, turn @ t)


def relative_pose_covariance(
    normalized_a: Array,
    normalized_b: Array,
    b_from_a: Pose,
    min_sigma: float,
    known_rotation: Array | None = None,
) -> Array:
    """Return the covariance (5, 5) of a relative pose fitted to image-plane matches (n, 2), (n, 2).

    Order as in `perturbed_relative`. The noise is estimated from the residuals; it is at least `min_sigma`, in
    image-plane units. `known_rotation` (3, 3) is the inverse covariance of a prior on the rotation. Raises
    `DegenerateGeometryError` when the matches don't determine the pose, as without any parallax. Source: first-order
    propagation of the Sampson error.
    """
    if len(normalized_a) < 6:
        raise DegenerateGeometryError("A relative pose's covariance needs six matches.")
    residuals = _signed_sampson(normalized_a, normalized_b, b_from_a)
    columns = []
    for k in range(5):
        change = np.zeros(5)
        change[k] = OPTIONS.difference_step_rad
        moved = _signed_sampson(normalized_a, normalized_b, perturbed_relative(b_from_a, change))
        columns.append((moved - residuals) / OPTIONS.difference_step_rad)
    jacobian = np.stack(columns, axis=1)
    freedom = np.sqrt(len(residuals) / (len(residuals) - 5))
    sigma = max(float(SIGMA_PER_MAD * np.median(np.abs(residuals)) * freedom), min_sigma)
    hessian = jacobian.T @ jacobian
    if known_rotation is not None:
        hessian[:3, :3] += sigma**2 * known_rotation
    values = np.linalg.eigvalsh(hessian)
    if not values[0] * COVARIANCE.max_condition > values[-1]:
        raise DegenerateGeometryError("The matches leave the relative pose open: is there any parallax?")
    return np.asarray(sigma**2 * np.linalg.inv(hessian))


def _signed_sampson(normalized_a: Array, normalized_b: Array, b_from_a: Pose) -> Array:
    matrix = essential_from_pose(b_from_a)
    a, b = homogeneous(normalized_a), homogeneous(normalized_b)
    return np.asarray(np.sum(b * (a @ matrix.T), axis=1) / sampson_slopes(matrix, a, b))
