"""The relative poses of two upright cameras that fit three matches exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A root of a real polynomial that is computed with a larger imaginary part is complex.
REAL_ROOT = 1e-6
# Values of q = tan(turn / 2) at which the polynomial of degree four is computed, to get its coefficients: Chebyshev
# nodes, at which this is well conditioned.
NODES = np.cos(np.pi * (np.arange(5) + 0.5) / 5)
COEFFICIENTS_FROM_VALUES = np.linalg.inv(np.vander(NODES, 5))


def upright_relative_poses(rays_a: Array, rays_b: Array) -> tuple[Array, Array]:
    """Return the turns (m,) about +y and the translations (m, 3), of length 1, of the poses that fit a sample exactly.

    A sample is three matches of rays (k, 3, 3), (k, 3, 3) in axes whose y is vertical. Each match says that the
    translation is perpendicular to the normal (R a) x b; the three normals must lie in one plane, which makes their
    determinant zero. With q = tan(turn / 2) it is a polynomial of degree six that holds the factor 1 + q^2, whose
    roots are not real; the quartic that remains gives up to four turns. Source: Fraundorfer et al., "A minimal case
    solution to the calibrated relative pose problem for the case of two known orientation angles", 2010.
    """
    values = np.stack([_determinant(rays_a, rays_b, q) for q in NODES], axis=-1)
    coefficients = values @ COEFFICIENTS_FROM_VALUES.T
    scale = np.abs(coefficients).max(axis=1)
    usable = np.abs(coefficients[:, 0]) > 1e-12 * scale
    coefficients, rays_a, rays_b = coefficients[usable], rays_a[usable], rays_b[usable]
    companion = np.zeros((len(coefficients), 4, 4))
    companion[:, 0] = -coefficients[:, 1:] / coefficients[:, :1]
    companion[:, 1:, :3] = np.eye(3)
    roots = np.linalg.eigvals(companion)
    is_real = np.abs(roots.imag) < REAL_ROOT * (1.0 + np.abs(roots.real))
    sample, _ = np.nonzero(is_real)
    turns_rad = 2.0 * np.arctan(roots.real[is_real])
    return turns_rad, _translations(rays_a[sample], rays_b[sample], turns_rad)


def _determinant(rays_a: Array, rays_b: Array, q: float) -> Array:
    """Return the determinants (k,) of the three normals at a turn, as a quartic in q.

    The determinant times (1 + q^2)^3 is the polynomial of degree six; without the factor 1 + q^2 it is this.
    """
    turn_rad = np.full(len(rays_a), 2.0 * np.arctan(q))
    return np.asarray(np.linalg.det(_normals(rays_a, rays_b, turn_rad)) * (1.0 + q * q) ** 2)


def _normals(rays_a: Array, rays_b: Array, turns_rad: Array) -> Array:
    """Return the normals (m, 3, 3), one a row, to which the translation is perpendicular."""
    cos, sin = np.cos(turns_rad)[:, None], np.sin(turns_rad)[:, None]
    x, y, z = np.moveaxis(rays_a, 2, 0)
    return np.cross(np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=2), rays_b)


def _translations(rays_a: Array, rays_b: Array, turns_rad: Array) -> Array:
    """Return the directions (m, 3) perpendicular to all three normals: the longest cross product of two."""
    normals = _normals(rays_a, rays_b, turns_rad)
    crosses = np.cross(normals, np.roll(normals, 1, axis=1))
    lengths = np.linalg.norm(crosses, axis=2)
    longest, rows = lengths.argmax(axis=1), np.arange(len(crosses))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(crosses[rows, longest] / lengths[rows, longest, None])
