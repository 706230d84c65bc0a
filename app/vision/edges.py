"""Straight edges in a picture, and the vertical that they determine."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.vertical import vertical_direction
from app.limits import limit
from app.vision.images import Gray, shrink


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeOptions:
    """Which edges are used, and how many of them must agree on the vertical."""

    max_side_px: int = limit(
        1280,
        "Edges are detected in the picture reduced to this length of its longer side.",
        chosen="By hand: the usual size of a monitoring camera's frame; bounds the time.",
    )
    min_length_ratio: float = limit(
        0.03,
        "Least length of an edge, relative to the picture's longer side.",
        chosen="By hand: the direction of a shorter edge is uncertain.",
    )
    min_edges: int = limit(
        12,
        "Least number of edges that agree on the vertical.",
        chosen="By hand: chance agreement of fewer edges is frequent.",
    )
    min_agreeing_share: float = limit(
        0.4,
        "Least share of the length of all steep edges that agrees on the vertical.",
        chosen="By hand: steep edges of furniture and stairs have other vanishing points.",
    )


OPTIONS = EdgeOptions()


def down_in_picture(gray: Gray, camera: Camera) -> NDArray[np.float64] | None:
    """Return down (3,) in the camera's axes, by the vertical edges of its image (height, width).

    None when too few edges agree, and for a camera that is tilted by more than 45 degrees.
    """
    starts, ends, lengths = straight_edges(gray, camera)
    if not len(lengths):
        return None
    vertical = vertical_direction(starts, ends, lengths)
    if vertical is None or vertical.edges < OPTIONS.min_edges:
        return None
    return vertical.down if vertical.share >= OPTIONS.min_agreeing_share else None


def straight_edges(
    gray: Gray, camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the straight edges of a camera's image (height, width): where they start and end, in image-plane
    coordinates (n, 2), (n, 2), and their lengths (n,) in pixels."""
    small, _ = shrink(gray, OPTIONS.max_side_px)
    camera = camera.scaled_to(small.shape[1], small.shape[0])
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(small)[0]
    edges = np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)
    lengths = np.hypot(edges[:, 2] - edges[:, 0], edges[:, 3] - edges[:, 1])
    long = lengths > OPTIONS.min_length_ratio * max(small.shape)
    starts, ends = (camera.normalize(edges[long, k : k + 2]) for k in (0, 2))
    seen = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
    return starts[seen], ends[seen], lengths[long][seen]
