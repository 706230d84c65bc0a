"""ORB features of a frame, and which of two frames' show the same: quick, and enough for views of one walk."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.limits import limit
from app.vision.images import Gray

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbOptions:
    """How many features a frame gets."""

    features: int = limit(700, "ORB features of a frame.", chosen="By hand: about 5 ms.")
    fast_threshold: int = limit(
        8,
        "Least difference of grey around a corner.",
        chosen="By hand: walls and blurred frames have few corners.",
    )


OPTIONS = OrbOptions()


def orb_features(gray: Gray) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the pixels (n, 2) and descriptors (n, 32) of a frame's features."""
    orb = cv2.ORB.create(nfeatures=OPTIONS.features, fastThreshold=OPTIONS.fast_threshold)
    found, descriptors = orb.detectAndCompute(gray, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 32), np.uint8)
    return np.array([point.pt for point in found], dtype=np.float64), np.asarray(descriptors, np.uint8)


def orb_matches(a: NDArray[np.uint8], b: NDArray[np.uint8], max_ratio: float) -> tuple[Rows, Rows]:
    """Return the rows (m,), (m,) of descriptors (n, 32), (k, 32) that match: the least distance is below `max_ratio`
    times the second least one."""
    if not len(a) or not len(b):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(a, b, k=2)
    good = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < max_ratio * pair[1].distance]
    rows = np.array([(match.queryIdx, match.trainIdx) for match in good], np.intp).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]
