"""Poses in files of their own, one matrix each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, check_pose_ratio
from app.importers.rows.matrices import COUNTS, poses_of_matrices
from app.importers.scan_files import numbers, read_text, rows

# A pose of 16 numbers takes less than this.
_MAX_POSE_BYTES = 4096


def read_pose_files(
    paths: Sequence[Path], names: Sequence[str], discarded: Discarded
) -> tuple[list[Pose | None], tuple[str, ...]]:
    """Return the pose in each of the files, None for what is none, such as NaN for lost tracking, and how all of
    them were read.

    `names` are the colour images, which are discarded as `invalid_pose`. Raises `InvalidScanError` when half of the
    poses or more can't be used, with the fault of the first.
    """
    values = [_numbers_of(path) for path in paths]
    poses, by_columns = poses_of_matrices([v if isinstance(v, np.ndarray) else np.zeros(0) for v in values])
    invalid = [i for i, pose in enumerate(poses) if pose is None]
    for i in invalid:
        discarded.add("invalid_pose", names[i])
    if invalid:
        first = invalid[0]
        fault = values[first]
        why = f" ({paths[first].name} {fault})" if isinstance(fault, str) else ""
        check_pose_ratio(len(invalid), len(poses), f"that of {names[first]}{why}")
    if by_columns:
        return poses, ("The pose files were read as matrices by columns, with the translation at the end.",)
    return poses, ()


def _numbers_of(path: Path) -> np.ndarray[tuple[int], np.dtype[np.float64]] | str:
    """Return the numbers of a pose file, or what is wrong with them."""
    try:
        if path.stat().st_size > _MAX_POSE_BYTES:
            return f"is larger than {_MAX_POSE_BYTES} bytes"
        cells = [cell for row in rows(read_text(path)) for cell in row.cells()]
        values = np.array(numbers(cells, path.name))
    except InvalidScanError:
        return "holds something that is not a number"
    except OSError:
        return "can't be read"
    if len(values) not in COUNTS:
        return f"has {len(values)} numbers, a pose has 16 or, without its last row, 12"
    return values
