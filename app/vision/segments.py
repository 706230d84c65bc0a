"""Distances from points to segments of lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def distances_to_segments(
    points: NDArray[np.float32], first: NDArray[np.float32], last: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the distances (...) of points (..., 3) from the segments between the ends `first` and `last` (..., 3),
    whose shapes broadcast, in the points' unit."""
    along = last - first
    squared = np.einsum("...i,...i->...", along, along)
    share = np.einsum("...i,...i->...", points - first, along) / np.maximum(
        squared, np.finfo(np.float32).tiny
    )
    nearest = first + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points - nearest, axis=-1), np.float32)
