"""How far a relative pose may be off, from the matches it was computed from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.covariance import SIGMA_PER_MAD
from app.geometry.epipolar import essential_from_pose, sampson_slopes
from app.geometry.se3 import Pose, rotation_from_vector
from app.geometry.triangulation import homogeneous

Array = NDArray[np.float64]
STEP = 1e-6
MAX_CONDITION = 1e12


def perturbed_relative(b_from_a: Pose, change: Array) -> Pose:
    """Return the relative pose after a change (5,): a rotation vector (on the left, rad), then two small turns of
    the translation's direction about the axes across it. The translation keeps its length."""
    t = b_from_a.translation
    across = np.linalg.svd(t[None])[2][1:]
    turn = rotation_from_vector(change[3] * across[0] + change[4] * across[1])
    return Pose(rotation_from_vector(change[:3]) @ b_from_a.rotation, turn @ t)


def relative_pose_covariance(
    normalized_a: Array,
    normalized_b: Array,
    b_from_a: Pose,
    min_sigma: float,
    known_rotation: Array | None = None,
) -> Array:
    """Return the covariance (5, 5) of a relative pose fitted to image-plane matches (n, 2), (n, 2).

    Order as in `perturbed_relative`. The noise comes from the residuals, at least `min_sigma`, in image-plane
    units. `known_rotation` (3, 3) is what else is known of the rotation, as an inverse covariance. Raises
    `DegenerateGeometryError` when the matches leave the pose open, as without any parallax. Source: first-order
    propagation of the Sampson error.
    """
    if len(normalized_a) < 6:
        raise DegenerateGeometryError("A relative pose's covariance needs six matches.")
    residuals = _signed_sampson(normalized_a, normalized_b, b_from_a)
    columns = []
    for k in range(5):
        change = np.zeros(5)
        change[k] = STEP
        moved = _signed_sampson(normalized_a, normalized_b, perturbed_relative(b_from_a, change))
        columns.append((moved - residuals) / STEP)
    jacobian = np.stack(columns, axis=1)
    freedom = np.sqrt(len(residuals) / (len(residuals) - 5))
    sigma = max(float(SIGMA_PER_MAD * np.median(np.abs(residuals)) * freedom), min_sigma)
    hessian = jacobian.T @ jacobian
    if known_rotation is not None:
        hessian[:3, :3] += sigma**2 * known_rotation
    values = np.linalg.eigvalsh(hessian)
    if not values[0] * MAX_CONDITION > values[-1]:
        raise DegenerateGeometryError("The matches leave the relative pose open: is there any parallax?")
    return np.asarray(sigma**2 * np.linalg.inv(hessian))


def _signed_sampson(normalized_a: Array, normalized_b: Array, b_from_a: Pose) -> Array:
    matrix = essential_from_pose(b_from_a)
    a, b = homogeneous(normalized_a), homogeneous(normalized_b)
    return np.asarray(np.sum(b * (a @ matrix.T), axis=1) / sampson_slopes(matrix, a, b))
