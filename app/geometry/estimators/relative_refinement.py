"""The relative pose of least Sampson error near a given one, with or without known verticals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.sampson import sampson_slopes
from app.geometry.se3 import rotation_from_vector, skew
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeRefinementOptions:
    """The weights of matches in the fit of a relative pose."""

    sigma_ratio: float = limit(
        0.35,
        "Standard deviation of a match's error over the largest error of an inlier.",
        chosen="By hand: the inlier limit is about three standard deviations.",
    )


OPTIONS = RelativeRefinementOptions()


@dataclass(frozen=True, slots=True)
class KnownVerticals:
    """Down in the axes of two cameras, (3,) each, and the standard deviation, in radians, of the angle between them."""

    in_a: Array
    in_b: Array
    sigma_rad: float

    def information(self) -> Array:
        """Return the inverse covariance (3, 3) that the verticals give a relative rotation's vector in b's axes.

        It is zero for rotations about the vertical, which the verticals don't determine.
        """
        return np.asarray((np.eye(3) - np.outer(self.in_b, self.in_b)) / self.sigma_rad**2)


@dataclass(frozen=True, slots=True)
class RelativePoseProblem:
    """Matched rays (n, 3), (n, 3), the verticals if known, and the error above which a match has no weight."""

    rays_a: Array
    rays_b: Array
    verticals: KnownVerticals | None
    max_error: float

    def refined(self, rotation: Array, translation: Array, steps: int) -> tuple[float, Array, Array]:
        """Return the least robust cost near a pose, and the rotation and translation there.

        Gauss-Newton, with known verticals as a prior.
        """
        best = np.inf, rotation, translation
        for _ in range(steps):
            cost, hessian, gradient, axes = self._system(rotation, translation)
            if cost < best[0]:
                best = cost, rotation, translation
            step = -np.linalg.solve(hessian + 1e-9 * np.trace(hessian) * np.eye(5), gradient)
            rotation = rotation_from_vector(step[:3]) @ rotation
            translation = translation + step[3:] @ axes
            translation = translation / np.linalg.norm(translation)
        cost, *_ = self._system(rotation, translation)
        return (cost, rotation, translation) if cost < best[0] else best

    def _system(self, rotation: Array, translation: Array) -> tuple[float, Array, Array, Array]:
        """Return the cost, the normal equations (5, 5), (5,), and two axes (2, 3) perpendicular to the translation.

        The unknowns are a rotation vector and the change of the translation along the two axes.
        """
        axes = np.linalg.svd(translation[None])[2][1:]
        turned = self.rays_a @ rotation.T
        slopes = sampson_slopes(skew(translation) @ rotation, self.rays_a, self.rays_b)
        slopes *= OPTIONS.sigma_ratio * self.max_error
        normals = _cross(turned, self.rays_b)
        errors = normals @ translation / slopes
        by_turn = _cross(turned, self.rays_b @ skew(translation).T) * -1.0
        jacobian = np.concatenate([by_turn, normals @ axes.T], axis=1) / slopes[:, None]
        weights = np.where(np.abs(errors) < 1.0 / OPTIONS.sigma_ratio, 1.0 / (1.0 + errors**2), 0.0)
        weighted = jacobian * weights[:, None]
        hessian, gradient = weighted.T @ jacobian, weighted.T @ errors
        cost = float(np.log1p(np.minimum(errors**2, OPTIONS.sigma_ratio**-2)).sum())
        if self.verticals is not None:
            down, sigma = rotation @ self.verticals.in_a, self.verticals.sigma_rad
            tilt = np.cross(down, self.verticals.in_b) / sigma
            by_tilt = (np.outer(down, self.verticals.in_b) - down @ self.verticals.in_b * np.eye(3)) / sigma
            hessian[:3, :3] += by_tilt.T @ by_tilt
            gradient[:3] += by_tilt.T @ tilt
            cost += float(tilt @ tilt)
        return cost, hessian, gradient, axes


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (n, 3) of rows, several times as fast as `numpy.cross`."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
