"""The covariance of a camera's pose that was fitted to points, by first-order error propagation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.camera import Camera
from app.geometry.reprojection import reprojection_jacobian
from app.geometry.rigs.refinement import rig_jacobian
from app.geometry.se3 import Pose
from app.geometry.validation import finite_pairs
from app.limits import limit

Array = NDArray[np.float64]

# A normal distribution's standard deviation over its median absolute deviation.
SIGMA_PER_MAD = 1.4826
# What is stacked of the terms of several cameras.
NOISY = ("jacobian", "point_noise")


@dataclass(frozen=True, slots=True, kw_only=True)
class CovarianceOptions:
    """Bounds of a covariance that comes from residuals."""

    min_sigma_px: float = limit(
        0.2,
        "Lower bound of the standard deviation of a pixel coordinate that is estimated from residuals.",
        chosen="By hand: the residuals of a fit to few points are too small, and no feature is located better.",
    )
    max_condition: float = limit(
        1e12,
        "Largest condition number of the normal equations; above it the points don't determine the pose.",
        chosen="By hand: near the limit of double precision.",
    )


OPTIONS = CovarianceOptions()


def pose_covariance(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    world_from_camera: Pose,
    sigma_px: float | None = None,
    *,
    point_sigma_m: ArrayLike | None = None,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
    centre_sigma_px: float = 0.0,
) -> Array:
    """Return the covariance (6, 6) of a pose that fits pixels (n, 2) to world points (n, 3) by least squares.

    Order: rotation vector in world axes (rad, applied on the left: R = exp(w) R_estimate), then the camera
    centre in world metres; see `app.geometry.reprojection.perturbed`. All correspondences must be inliers.
    `sigma_px` is the standard deviation of a pixel coordinate, by default estimated from the residuals;
    `point_sigma_m`, (n,) or one number, that of a world coordinate. A focal length or a radial coefficient that was
    fitted to the same points makes the pose less certain: `focal_sigma` is the relative standard deviation of the
    focal length before that fit, `lens_sigma` that of the coefficient; 0 for a value that was not fitted, infinity
    for one that was not known at all. `centre_sigma_px` is the standard deviation of either coordinate of a principal
    point that was taken as it is: its error moves the pose, however many points there are. Errors that all points
    share, such as the map's own, are not included. Raises `DegenerateGeometryError` for points that leave the pose
    undetermined, `InvalidInputError` for a bad number.
    Source: first-order error propagation.
    """
    terms = camera_terms(points_px, points_in_world, camera, world_from_camera, point_sigma_m)
    if len(terms.jacobian) < 3:
        raise DegenerateGeometryError("A pose covariance needs at least three points in front of the camera.")
    return covariance_of_terms(
        [terms], sigma_px, focal_sigma=focal_sigma, lens_sigma=lens_sigma, centre_sigma_px=centre_sigma_px
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraTerms:
    """What one camera contributes to the covariance of a pose, for the points that it has in view.

    `residuals` (n, 2) in pixels, `jacobian` (n, 2, 6) by the perturbation of the pose, `point_noise` (n, 2, 2) the
    covariance of the pixels by the noise of the points, `by_log_focal` and `by_lens` (n, 2) the derivatives by the
    focal length's logarithm and by the radial coefficient.
    """

    residuals: Array
    jacobian: Array
    point_noise: Array
    by_log_focal: Array
    by_lens: Array

    def moved(self, rig_centre_to_camera: Array) -> CameraTerms:
        """Return the terms by the perturbation of a rig's pose, from whose centre the camera's is the vector (3,) in
        world axes."""
        return replace(self, jacobian=rig_jacobian(self.jacobian, rig_centre_to_camera))


def camera_terms(
    points_px: ArrayLike,
    points_in_world: ArrayLike,
    camera: Camera,
    world_from_camera: Pose,
    point_sigma_m: ArrayLike | None,
) -> CameraTerms:
    """Return the terms of pixels (n, 2) and world points (n, 3); raises `InvalidInputError` for a bad number."""
    pixels, points = finite_pairs(points_px, 2, "pixels", points_in_world, 3, "world points")
    projected, jacobian, by_point = reprojection_jacobian(points, camera, world_from_camera)
    focal_px, centre_px = camera.focal_px, camera.principal_point_px
    seen = np.isfinite(jacobian).all(axis=(1, 2))
    projected, jacobian, by_point = projected[seen], jacobian[seen], by_point[seen]
    variance = _variances(point_sigma_m, len(points), "point_sigma_m")[seen]
    by_log_focal = projected - centre_px
    return CameraTerms(
        residuals=projected - pixels[seen],
        jacobian=jacobian,
        point_noise=variance[:, None, None] * (by_point @ by_point.transpose(0, 2, 1)),
        by_log_focal=by_log_focal,
        by_lens=by_log_focal * np.sum((by_log_focal / focal_px) ** 2, axis=1)[:, None],
    )


def covariance_of_terms(
    terms: Sequence[CameraTerms],
    sigma_px: float | None = None,
    *,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
    centre_sigma_px: float = 0.0,
) -> Array:
    """Return the covariance (6, 6) of the pose that all terms are about, as `pose_covariance` has it; focal length,
    lens and principal point are the same for all."""
    jacobian, noise = (np.concatenate([getattr(each, name) for each in terms]) for name in NOISY)
    if sigma_px is None:
        sigma_px = _sigma_of_pixels(np.concatenate([each.residuals for each in terms]), noise)
    pixel_variance = _variances(sigma_px, 1, "sigma_px")[0]
    noise = noise + pixel_variance * np.eye(2)
    for name, sigma in ("by_log_focal", focal_sigma), ("by_lens", lens_sigma):
        if sigma > 0:
            by_one = np.concatenate([getattr(each, name) for each in terms])
            jacobian, noise = _with_unknown(jacobian, noise, by_one, sigma)
    # The priors, which are the last rows, are about no pixel.
    points = sum(len(each.jacobian) for each in terms)
    return _least_squares_covariance(jacobian, noise, points, centre_sigma_px)[:6, :6]


def _with_unknown(jacobian: Array, noise: Array, by_unknown: Array, sigma: float) -> tuple[Array, Array]:
    """Return the Jacobian (n + 1, 2, p + 1) and the noise (n + 1, 2, 2) with one more unknown that has a prior.

    `by_unknown` (n, 2) are the derivatives by it, `sigma` is the standard deviation of the prior. The prior is an
    additional observation, scaled to the noise of a typical pixel; an infinite sigma adds none.
    """
    extra = np.zeros((len(jacobian), 2, 1))
    extra[: len(by_unknown), :, 0] = by_unknown
    jacobian = np.concatenate([jacobian, extra], axis=2)
    if np.isinf(sigma):
        return jacobian, noise
    typical = float(np.mean(np.diagonal(noise, axis1=1, axis2=2)))
    row = np.zeros((1, 2, jacobian.shape[2]))
    row[0, 0, -1] = np.sqrt(typical) / sigma
    return np.concatenate([jacobian, row]), np.concatenate([noise, typical * np.eye(2)[None]])


def pose_accuracy(covariance: ArrayLike) -> tuple[float, float]:
    """Return the standard deviations of position in metres and of orientation in degrees, by a covariance (6, 6).

    Each is the square root of the trace of its block: the root mean square length of the error.
    """
    variances = np.diag(np.asarray(covariance, dtype=np.float64))
    rotation, position = np.sqrt(variances[:3].sum()), np.sqrt(variances[3:].sum())
    return float(position), float(np.degrees(rotation))


def sigma_px_from_residuals(residuals_px: ArrayLike) -> float:
    """Return the standard deviation of a pixel coordinate by the residuals (n, 2) of a fit with six parameters.

    The median absolute deviation, scaled to a normal distribution and corrected for the degrees of freedom; at least
    `OPTIONS.min_sigma_px`.
    """
    values = np.abs(np.asarray(residuals_px, dtype=np.float64).reshape(-1))
    freedom = np.sqrt(values.size / max(values.size - 6, 1))
    return max(float(SIGMA_PER_MAD * np.median(values) * freedom), OPTIONS.min_sigma_px)


def _sigma_of_pixels(residuals: Array, point_noise: Array) -> float:
    """Return the standard deviation of the residuals (n, 2) that remains without the points' noise (n, 2, 2)."""
    total = sigma_px_from_residuals(residuals) ** 2
    explained = float(np.median(np.diagonal(point_noise, axis1=1, axis2=2)))
    return float(np.sqrt(max(total - explained, OPTIONS.min_sigma_px**2)))


def _variances(sigma: ArrayLike | None, count: int, name: str) -> Array:
    values = np.asarray(0.0 if sigma is None else sigma, dtype=np.float64)
    if values.shape not in ((), (count,)) or not np.isfinite(values).all() or (values < 0).any():
        raise InvalidInputError(f"{name} must be one number, or one per point, finite and not negative.")
    return np.broadcast_to(values**2, (count,))


def _least_squares_covariance(jacobian: Array, noise: Array, points: int, centre_sigma_px: float) -> Array:
    """Return (J'J)^-1 J'NJ (J'J)^-1 of a Jacobian (n, 2, p) and the points' noise N (n, 2, 2), and what an error of the
    principal point, which the first `points` rows share, adds to it."""
    # With columns of unit length the condition number doesn't depend on the units of the unknowns.
    lengths = np.linalg.norm(jacobian, axis=(0, 1))
    scaled = jacobian / np.maximum(lengths, 1e-12)
    rows = scaled.reshape(-1, jacobian.shape[2])
    hessian = rows.T @ rows
    eigenvalues = np.linalg.eigvalsh(hessian)
    if eigenvalues[0] * OPTIONS.max_condition < eigenvalues[-1]:
        raise DegenerateGeometryError(
            "The points leave the pose undetermined: are they on one line or in one spot?"
        )
    solver = np.linalg.inv(hessian) / np.maximum(lengths, 1e-12)
    covariance = solver.T @ (rows.T @ (noise @ scaled).reshape(rows.shape)) @ solver
    by_centre = centre_sigma_px * solver.T @ scaled[:points].sum(axis=0).T
    covariance += by_centre @ by_centre.T
    return np.asarray(0.5 * (covariance + covariance.T))
