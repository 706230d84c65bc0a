"""Printed ArUco markers in the pictures of a reconstruction, and the lengths of their sides in its unit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.tracks import depth_near, point_of_pixels
from app.engine.progress import Progress, map_in_order
from app.vision.images import Gray

Array = NDArray[np.float64]
DICTIONARY = cv2.aruco.DICT_4X4_50
CORNERS = 4


@dataclass(frozen=True, slots=True)
class MarkerSides:
    """In how many pictures a marker was seen, and the lengths (n,) of the sides that could be measured."""

    seen: int
    sides: Array


def marker_sides(
    part: Reconstruction, gray: Callable[[int], Gray], executor: Executor, progress: Progress
) -> MarkerSides:
    """Return the sides of all markers; `gray` reads pictures by row."""
    rows = list(part.poses)
    found = list(map_in_order(executor, lambda row: _markers(gray(row)), rows, "find_marker", progress))
    corners: dict[int, dict[int, Array]] = defaultdict(dict)
    for row, markers in zip(rows, found, strict=True):
        for number, pixels in markers.items():
            corners[number][row] = pixels
    sides = [length for views in corners.values() for length in _sides(part, views)]
    return MarkerSides(sum(bool(markers) for markers in found), np.array(sides))


def _markers(gray: Gray) -> dict[int, Array]:
    """Return the corners (4, 2) of the markers in a picture by their number."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARY), parameters)
    corners, numbers, _ = detector.detectMarkers(gray)
    if numbers is None:
        return {}
    return {
        int(number): np.asarray(own[0], dtype=np.float64)
        for number, own in zip(numbers.ravel(), corners, strict=True)
    }


def _sides(part: Reconstruction, views: dict[int, Array]) -> list[float]:
    """Return the lengths of the sides of a marker that is seen at corners (4, 2) in pictures."""
    # The view from nearest, in which the corners are most exact, comes first.
    rows = sorted(views, key=lambda row: -cv2.contourArea(views[row].astype(np.float32)))
    if not rows:
        return []
    start = depth_near(part, rows[0], views[rows[0]].mean(axis=0))
    points = [point_of_pixels(part, {row: views[row][k] for row in rows}, start) for k in range(CORNERS)]
    pairs = [(points[k], points[(k + 1) % CORNERS]) for k in range(CORNERS)]
    return [float(np.linalg.norm(b - a)) for a, b in pairs if a is not None and b is not None]
