"""The sparse map (B 2.2, table 1): which of a keyframe's features are kept when there is room for only so many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.options import MIN_FEATURES_PER_KEYFRAME, BuildOptions
from app.engine.maps.points import MapPoints
from app.geometry.camera import Camera
from app.vision.features import LocalFeatureExtractor

# What a keyframe of a map without pictures may take, its global descriptor included.
MAX_KEYFRAME_BYTES = 100_000
# Pixel, point and sigma of a feature as float32, and what looks like it elsewhere; pose, camera and offset of a
# keyframe.
FEATURE_BYTES, KEYFRAME_BYTES = 30, 68
# More views than this say no more about whether a feature will be found again.
MANY_VIEWS = 4
GRID = (8, 6)


def feature_limit(
    options: BuildOptions, extractor: LocalFeatureExtractor, global_descriptor_size: int
) -> int | None:
    """Return how many features a keyframe may keep, None for all of them.

    What the options say; else, for a map without pictures, what fits into `MAX_KEYFRAME_BYTES`.
    """
    if options.max_features_per_keyframe is not None:
        return options.max_features_per_keyframe
    if options.store_images:
        return None
    # Learned descriptors are stored in half precision.
    width = 2 if extractor.descriptor_dtype is np.float32 else 1
    left = MAX_KEYFRAME_BYTES - KEYFRAME_BYTES - 4 * global_descriptor_size
    return max(MIN_FEATURES_PER_KEYFRAME, left // (FEATURE_BYTES + width * extractor.descriptor_size))


def thin_out(points: MapPoints, camera: Camera, limit: int | None) -> MapPoints:
    """Return at most `limit` of a keyframe's features, spread over its image.

    Taken in turns from the cells of an 8 x 6 grid, in each the features first that most views of the scan saw,
    and of these the points known best.
    """
    if limit is None or len(points.features) <= limit:
        return points
    # Within its cell each feature has a rank; all first ones are taken, then all second ones.
    order = np.lexsort((points.sigma_m, -np.minimum(points.views, MANY_VIEWS)))
    cells = _cells(points.features.keypoints_px, camera)
    ranks = np.zeros(len(order), dtype=np.intp)
    taken = np.zeros(GRID[0] * GRID[1], dtype=np.intp)
    for row in order:
        ranks[row] = taken[cells[row]]
        taken[cells[row]] += 1
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    return points.take(np.sort(np.lexsort((place, ranks))[:limit]))


def _cells(keypoints_px: NDArray[np.float32], camera: Camera) -> NDArray[np.intp]:
    size = np.array([camera.width, camera.height])
    columns = np.clip(((keypoints_px + 0.5) / size * GRID).astype(np.intp), 0, np.array(GRID) - 1)
    return np.asarray(columns[:, 0] * GRID[1] + columns[:, 1])
