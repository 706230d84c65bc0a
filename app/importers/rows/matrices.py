"""Poses written as matrices: 4x4 or 3x4, by rows or by columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidPoseError
from app.geometry.se3 import Pose

Array = NDArray[np.float64]

# How many numbers a matrix of a pose has.
COUNTS = (12, 16)


def poses_of_matrices(rows: Sequence[Array]) -> tuple[list[Pose | None], bool]:
    """Return the poses of matrices given as 12 or 16 numbers each, None for numbers that are no pose.

    All of them stand by rows, or all by columns if more of them are poses that way; the second value says so. A
    matrix by columns has its translation at the end, a 4x4 in its bottom row.
    """
    by_rows = [_pose(values, by_columns=False) for values in rows]
    if all(by_rows):
        return by_rows, False
    by_columns = [_pose(values, by_columns=True) for values in rows]
    if _count(by_columns) > _count(by_rows):
        return by_columns, True
    return by_rows, False


def _count(poses: list[Pose | None]) -> int:
    return sum(pose is not None for pose in poses)


def _pose(values: Array, by_columns: bool) -> Pose | None:
    if len(values) not in COUNTS:
        return None
    matrix = values.reshape(4, -1).T if by_columns else values.reshape(-1, 4)
    square = matrix if len(matrix) == 4 else np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    try:
        return Pose.from_matrix(square)
    except InvalidPoseError:
        return None
