"""Printed ArUco markers in the pictures of a reconstruction, and the lengths of their sides in its unit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.tracks import OPTIONS as TRACKS
from app.engine.mapping.structure.tracks import depth_near
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import REFERENCE_FOCAL_PX
from app.geometry.se3 import Pose, rotation_from_vector, vector_from_rotation
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]
DICTIONARY = cv2.aruco.DICT_4X4_50
CORNERS = 4
# A square of side 1 in its own plane, in the order of OpenCV's corners: top left, then clockwise.
SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerOptions:
    """How a square is fitted to the corners of a marker."""

    loss_scale_px: float = limit(
        1.0,
        "Error of a corner at which its weight falls (soft L1 loss).",
        chosen="By hand: corners are found to a third of a pixel.",
    )
    corner_sigma_px: float = limit(
        0.3,
        "Standard deviation of a corner, at least.",
        chosen="By hand: as OpenCV's refinement of corners.",
    )


OPTIONS = MarkerOptions()


@dataclass(frozen=True, slots=True)
class MarkerSides:
    """In how many pictures a marker was seen, and the length (n,) of the side of each one that could be measured."""

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
    sides = [side for views in corners.values() if (side := side_of(part, views)) is not None]
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


def side_of(part: Reconstruction, views: dict[int, Array]) -> float | None:
    """Return the length of the side of a marker that is seen at corners (4, 2) in pictures.

    One square is fitted to all corners in all pictures at once; None where too few pictures agree on it, or where they
    are too near to each other to show how large it is. One by one, the corners of a marker that is filmed while
    walking past tilt it: a depth that is off by a tenth makes a side longer by some percent.
    """
    # The view from nearest, in which the corners are most exact, is where the square starts.
    rows = sorted(views, key=lambda row: -cv2.contourArea(views[row].astype(np.float32)))
    max_error_px = TRACKS.max_error_px * part.camera.focal_px / REFERENCE_FOCAL_PX
    while len(rows) >= TRACKS.min_views:
        fits = [_fitted(part, views, rows, start) for start in _starts(part, rows[0], views[rows[0]])]
        if not fits:
            return None
        fit = min(fits, key=lambda each: float(each.cost))
        errors_px = np.linalg.norm(
            _errors_px(fit.x, part, views, rows).reshape(len(rows), CORNERS, 2), axis=2
        )
        kept = [row for row, worst in zip(rows, errors_px.max(axis=1), strict=True) if worst <= max_error_px]
        if len(kept) == len(rows):
            noise_px = max(OPTIONS.corner_sigma_px, float(np.sqrt(np.mean(errors_px**2) / 2)))
            sigma = noise_px * float(np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac)[-1, -1]))
            return float(np.exp(fit.x[-1])) if sigma <= TRACKS.max_sigma_ratio else None
        rows = kept
    return None


def _starts(part: Reconstruction, row: int, corners: Array) -> list[Array]:
    """Return squares (7,) that one picture may show, at the depth of what is reconstructed near it."""
    rays = part.camera.normalize(corners)
    found, turns, places, _ = cv2.solvePnPGeneric(
        SQUARE, rays[:, None], np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    starts = []
    for turn, place in zip(turns, places, strict=True) if found else ():
        centre = np.asarray(place, dtype=np.float64).ravel()
        side = depth_near(part, row, corners.mean(axis=0)) / float(centre[2])
        if side > 0:
            scan_from_square = part.poses[row] @ Pose(rotation_from_vector(turn.ravel()), side * centre)
            turned = vector_from_rotation(scan_from_square.rotation)
            starts.append(np.concatenate([turned, scan_from_square.translation, [np.log(side)]]))
    return starts


def _fitted(part: Reconstruction, views: dict[int, Array], rows: list[int], start: Array) -> Any:
    return least_squares(
        _errors_px,
        start,
        args=(part, views, rows),
        loss="soft_l1",
        f_scale=OPTIONS.loss_scale_px,
        x_scale="jac",
    )


def _errors_px(square: Array, part: Reconstruction, views: dict[int, Array], rows: list[int]) -> Array:
    """Return the errors (8 n,) of the corners of a square (7,) in pictures: rotation vector, centre, logarithm of the
    side."""
    scan_from_square = Pose(rotation_from_vector(square[:3]), square[3:6])
    corners = scan_from_square.apply(np.exp(square[6]) * SQUARE)
    errors = []
    for row in rows:
        local = part.poses[row].inverse().apply(corners)
        seen = local[:, :2] / np.maximum(local[:, 2:], np.finfo(float).eps)
        errors.append(part.camera.focal_px * (seen - part.camera.normalize(views[row])))
    return np.concatenate(errors).ravel()
