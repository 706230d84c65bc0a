"""The sparse map (B 2.2, table 1): which of a keyframe's features are kept where their number is limited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.options import MIN_FEATURES_PER_KEYFRAME, BuildOptions
from app.engine.maps.points import MapPoints
from app.geometry.camera import Camera
from app.limits import limit
from app.vision.features import LocalFeatureExtractor

# A feature's pixel, point and sigma as float32, and the distance and keyframe of the most similar one elsewhere.
FEATURE_BYTES = 30
# A keyframe's pose, camera and offset.
KEYFRAME_BYTES = 68
FLOAT32_BYTES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class SparseMapOptions:
    """How many features a keyframe of a map without pictures keeps, and which."""

    max_keyframe_bytes: int = limit(
        100_000,
        "Largest size of a keyframe in a map without pictures, with its global descriptor.",
        chosen="By hand: room for more than 400 features by every method "
        "(`roomfix keyframes ... --sparse`; docs/visual-depth-map.md).",
    )
    many_views: int = limit(
        4,
        "Number of views that saw a feature from which on more views don't rank it higher.",
        chosen="By hand: more views say no more about whether a query finds the feature.",
    )
    grid_columns: int = limit(
        8,
        "Columns of the grid over which features are spread.",
        chosen="By hand; no measurement is recorded.",
    )
    grid_rows: int = limit(
        6, "Rows of the grid over which features are spread.", chosen="By hand; no measurement is recorded."
    )


OPTIONS = SparseMapOptions()
GRID = (OPTIONS.grid_columns, OPTIONS.grid_rows)


def feature_limit(
    options: BuildOptions, extractor: LocalFeatureExtractor, global_descriptor_size: int
) -> int | None:
    """Return the largest number of features of a keyframe, None where it keeps them all.

    It is that of the build's options or else, for a map without pictures, what fits into the size of a keyframe.
    """
    if options.max_features_per_keyframe is not None:
        return options.max_features_per_keyframe
    if options.store_images:
        return None
    # Learned descriptors are stored in half precision.
    width = 2 if extractor.descriptor_dtype is np.float32 else 1
    left = OPTIONS.max_keyframe_bytes - KEYFRAME_BYTES - FLOAT32_BYTES * global_descriptor_size
    return max(MIN_FEATURES_PER_KEYFRAME, left // (FEATURE_BYTES + width * extractor.descriptor_size))


def thin_out(points: MapPoints, camera: Camera, limit: int | None) -> MapPoints:
    """Return at most `limit` of a keyframe's features, spread over its image.

    They are taken in turns from the cells of a grid. Within a cell the features that more views of the scan saw come
    first, and among those with equally many views the points with the smaller standard deviation.
    """
    if limit is None or len(points.features) <= limit:
        return points
    # Within its cell each feature has a rank: the first of all cells are taken, then the second of all cells.
    order = np.lexsort((points.sigma_m, -np.minimum(points.views, OPTIONS.many_views)))
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
