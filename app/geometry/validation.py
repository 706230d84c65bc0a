"""Checks of the arrays that the functions of geometry take, so that no solver gets a NaN."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidInputError

Array = NDArray[np.float64]


def finite_points(values: ArrayLike, columns: int, name: str) -> Array:
    """Return `values` as (n, columns) floats; raises `InvalidInputError` naming `name` otherwise."""
    points = np.ascontiguousarray(values, dtype=np.float64)
    if points.size == 0:
        points = points.reshape(-1, columns)
    if points.ndim != 2 or points.shape[1] != columns:
        raise InvalidInputError(f"{name} must have the shape (n, {columns}), got {points.shape}.")
    if not np.isfinite(points).all():
        raise InvalidInputError(f"{name} holds numbers that are not finite.")
    return points


def finite_vector(values: ArrayLike, size: int, name: str) -> Array:
    """Return `values` as (size,) floats; raises `InvalidInputError` naming `name` otherwise."""
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise InvalidInputError(f"{name} must be {size} finite numbers.")
    return vector


def unit_vector(values: ArrayLike, size: int, name: str) -> Array:
    """Return the direction (size,) of `values`, of length 1; raises `InvalidInputError` for a zero vector."""
    vector = finite_vector(values, size, name)
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise InvalidInputError(f"{name} has no direction: its length is zero.")
    return np.asarray(vector / length)


def finite_pairs(
    a: ArrayLike, a_columns: int, a_name: str, b: ArrayLike, b_columns: int, b_name: str
) -> tuple[Array, Array]:
    """Return two arrays of equally many points; raises `InvalidInputError` naming them otherwise."""
    first, second = finite_points(a, a_columns, a_name), finite_points(b, b_columns, b_name)
    if len(first) != len(second):
        raise InvalidInputError(f"{len(first)} {a_name} can't correspond to {len(second)} {b_name}.")
    return first, second
