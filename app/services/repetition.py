"""What in a map looks like something elsewhere in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.vision.local_features import Descriptors
from app.vision.repetition import find_repetition


def elsewhere(
    descriptors: Descriptors | NDArray[np.float16],
    binary: bool,
    points_in_world: NDArray[np.float32],
    offsets: NDArray[np.int64],
) -> tuple[NDArray[np.float16], NDArray[np.int32]]:
    """Return a map's `distance_elsewhere` and `keyframe_elsewhere` (both (f,)) from its other arrays."""
    found = find_repetition(descriptors, binary, points_in_world)
    keyframes = np.searchsorted(offsets, found.row, side="right") - 1
    return found.distance.astype(np.float16), np.where(found.row < 0, -1, keyframes).astype(np.int32)
