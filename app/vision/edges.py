"""Straight edges in a picture, and the vertical that they show."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.vertical import vertical_direction
from app.vision.images import Gray, shrink

# Edges are found in pictures of at most this size.
MAX_SIDE_PX = 1280
# Of the picture's longer side; a shorter edge doesn't tell its direction well.
MIN_LENGTH_SHARE = 0.03
# So many edges, and such a share of the length of all steep ones, must agree on the vertical.
MIN_EDGES, MIN_SHARE = 12, 0.4


def down_in_picture(gray: Gray, camera: Camera) -> NDArray[np.float64] | None:
    """Return down (3,) in the axes of the camera of an image (height, width), by the vertical edges that it shows, or
    None when they don't tell. A camera that is tilted by more than 45 degrees has none."""
    small, _ = shrink(gray, MAX_SIDE_PX)
    camera = camera.scaled_to(small.shape[1], small.shape[0])
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(small)[0]
    if found is None:
        return None
    edges = np.asarray(found, dtype=np.float64).reshape(-1, 4)
    lengths = np.hypot(edges[:, 2] - edges[:, 0], edges[:, 3] - edges[:, 1])
    long = lengths > MIN_LENGTH_SHARE * max(small.shape)
    starts, ends = (camera.normalize(edges[long, k : k + 2]) for k in (0, 2))
    seen = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
    if not seen.any():
        return None
    vertical = vertical_direction(starts[seen], ends[seen], lengths[long][seen])
    if vertical is None or vertical.edges < MIN_EDGES or vertical.share < MIN_SHARE:
        return None
    return vertical.down
