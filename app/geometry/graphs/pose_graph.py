"""Poses that fit measured motions between them best: a pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from app.geometry.se3 import Pose, perturbed, skew, vector_from_rotation

Array = NDArray[np.float64]
# Rows and columns within a block.
WITHIN = np.mgrid[:6, :6].reshape(2, -1)


@dataclass(frozen=True, slots=True)
class Motion:
    """A measured `a_from_b` between the poses of two rows, and the weights (6,) of its error: the inverse standard
    deviations of rotation (1/rad) and position (1/m) in the axes of `a`."""

    a: int
    b: int
    a_from_b: Pose
    weights: Array


@dataclass(frozen=True, slots=True)
class Known:
    """A pose that is known by itself, and the weights (6,) of its error, in the axes of the world."""

    row: int
    pose: Pose
    weights: Array


def isotropic_weights(position_m: float, rotation_rad: float) -> Array:
    """Return the weights (6,) of standard deviations that are lengths of three-dimensional errors."""
    scale = np.sqrt(3.0)
    return np.repeat([scale / rotation_rad, scale / position_m], 3)


def gauss_newton_step(poses: Sequence[Pose], motions: Sequence[Motion], known: Sequence[Known]) -> Array:
    """Return the step (n, 6), to be applied by `perturbed`, towards the least sum of squared weighted errors."""
    blocks = _Blocks()
    residuals: list[Array] = []
    for row, motion in enumerate(motions):
        error, by_a, by_b = relative_error(poses[motion.a], poses[motion.b], motion.a_from_b)
        blocks.add(row, motion.a, motion.weights[:, None] * by_a)
        blocks.add(row, motion.b, motion.weights[:, None] * by_b)
        residuals.append(motion.weights * error)
    for each in known:
        turn = vector_from_rotation(poses[each.row].rotation @ each.pose.rotation.T)
        error = np.concatenate([turn, poses[each.row].translation - each.pose.translation])
        blocks.add(len(residuals), each.row, np.diag(each.weights))
        residuals.append(each.weights * error)
    jacobian = blocks.matrix(len(residuals), len(poses))
    normal = (jacobian.T @ jacobian).tocsc()
    return np.asarray(-spsolve(normal, jacobian.T @ np.concatenate(residuals))).reshape(-1, 6)


def moved(poses: Sequence[Pose], step: Array) -> list[Pose]:
    """Return the poses after a step (n, 6)."""
    return [perturbed(pose, change) for pose, change in zip(poses, step, strict=True)]


def relative_error(a: Pose, b: Pose, a_from_b: Pose) -> tuple[Array, Array, Array]:
    """Return by how much two poses differ from a motion between them (6,), rotation vector before position, and the
    derivatives (6, 6) by the perturbation of each."""
    offset, to_a = b.translation - a.translation, a.rotation.T
    turn = vector_from_rotation(a_from_b.rotation.T @ to_a @ b.rotation)
    error = np.concatenate([turn, to_a @ offset - a_from_b.translation])
    by_a, by_b = np.zeros((6, 6)), np.zeros((6, 6))
    by_b[:3, :3], by_a[:3, :3] = b.rotation.T, -b.rotation.T
    by_b[3:, 3:], by_a[3:, 3:] = to_a, -to_a
    by_a[3:, :3] = to_a @ skew(offset)
    return error, by_a, by_b


class _Blocks:
    """A sparse matrix of blocks (6, 6)."""

    def __init__(self) -> None:
        self._places: list[NDArray[np.intp]] = []
        self._values: list[Array] = []

    def add(self, row: int, column: int, block: Array) -> None:
        """Add a block at a row and column of blocks."""
        i, j = WITHIN
        self._places.append(np.stack([6 * row + i, 6 * column + j]))
        self._values.append(block.ravel())

    def matrix(self, rows: int, columns: int) -> csr_matrix:
        """Return the matrix of that number of blocks each way."""
        i, j = np.concatenate(self._places, axis=1)
        return csr_matrix((np.concatenate(self._values), (i, j)), shape=(6 * rows, 6 * columns))
