"""Sampson errors: how far matches of two images are from agreeing with an essential matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.triangulation import homogeneous

Array = NDArray[np.float64]


def sampson_errors(E: ArrayLike, normalized_a: ArrayLike, normalized_b: ArrayLike) -> Array:
    """Return the Sampson errors (n,) of matches (n, 2), (n, 2): the first-order distance from b^T E a = 0."""
    matrix = np.asarray(E, dtype=np.float64)
    a, b = homogeneous(normalized_a), homogeneous(normalized_b)
    return np.asarray(np.abs(np.sum(b * (a @ matrix.T), axis=1)) / sampson_slopes(matrix, a, b))


def sampson_slopes(E: Array, rays_a: Array, rays_b: Array) -> Array:
    """Return the norm (n,) of the gradient of b^T E a by the image-plane points of matched rays (n, 3), (n, 3)."""
    line_b, line_a = rays_a @ E.T, rays_b @ E
    squared = np.sum(line_a[:, :2] ** 2, axis=1) + np.sum(line_b[:, :2] ** 2, axis=1)
    return np.asarray(np.maximum(np.sqrt(squared), 1e-15))
