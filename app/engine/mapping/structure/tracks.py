"""Points of a reconstruction by pixels: what one pixel shows, and what pixels of several views show."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.errors import InvalidScanError
from app.geometry.camera import REFERENCE_FOCAL_PX
from app.geometry.ray_depth import Observations, refine_depth_along_rays
from app.geometry.triangulation import homogeneous
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]
Pixels = Mapping[int, Array]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOptions:
    """How a pixel is followed into other pictures, and when its point is known."""

    near_features: int = limit(
        5, "Nearest features whose depth a pixel is first taken to have.", chosen="By hand: a median of few."
    )
    views: int = limit(16, "Pictures that a pixel is followed into.", chosen="By hand: more add little.")
    window_px: int = limit(21, "Side of the patch that is followed.", chosen="By hand: OpenCV's default.")
    levels: int = limit(
        3, "Levels of the image pyramid.", chosen="By hand: eight pixels of error at the start."
    )
    max_return_px: float = limit(
        1.0,
        "Largest distance after the patch is followed back.",
        chosen="By hand: it slid along an edge else.",
    )
    rounds: int = limit(3, "Rounds of following and triangulating.", chosen="By hand: each starts nearer.")
    max_error_px: float = limit(
        4.0,
        "Largest reprojection error of a view that takes part, at the focal length of reference.",
        chosen="By hand: a patch that was followed to something else is far off.",
    )
    min_views: int = limit(
        3, "Least number of views of a point.", chosen="By hand: two can't contradict each other."
    )
    prior_ratio: float = limit(
        1.0,
        "Standard deviation of the depth at the start, relative to it.",
        chosen="By hand: as good as unknown.",
    )
    max_sigma_ratio: float = limit(
        0.02,
        "Largest standard deviation of a depth, relative to it.",
        chosen="By hand: what a scale may be off by.",
    )


OPTIONS = TrackOptions()


def point_of_pixels(part: Reconstruction, pixels: Pixels, start_depth: float) -> Array | None:
    """Return the point (3,) that pixels (2,) by row of the picture show; None where they don't agree on one.

    `start_depth` is a depth in the first of the pictures from which the search starts.
    """
    rows = list(pixels)
    for _ in range(len(rows)):
        if len(rows) < OPTIONS.min_views:
            return None
        own = part.poses[rows[0]]
        seen = _observations(part, pixels, rows[1:])
        ray = homogeneous(part.camera.normalize(pixels[rows[0]]))
        found = refine_depth_along_rays(
            ray @ own.rotation.T,
            own.translation,
            np.array([start_depth]),
            seen,
            steps=20,
            prior_sigma=OPTIONS.prior_ratio,
        )
        point = own.apply(ray * found.depth_m[0])[0]
        errors = {row: _error_px(part, row, pixels[row], point) for row in rows[1:]}
        worst = max(errors, key=lambda row: errors[row])
        if errors[worst] <= OPTIONS.max_error_px * part.camera.focal_px / REFERENCE_FOCAL_PX:
            return point if found.sigma_m[0] <= OPTIONS.max_sigma_ratio * found.depth_m[0] else None
        rows.remove(worst)
    return None


def point_of_pixel(part: Reconstruction, row: int, pixel: Array, gray: Callable[[int], Gray]) -> Array:
    """Return the point (3,) that a pixel (2,) of a picture shows; `gray` reads pictures by row.

    The pixel is followed into other pictures of the same points. Raises `InvalidScanError` where that fails.
    """
    depth, others = depth_near(part, row, pixel), _sharing(part, row)
    point: Array | None = None
    own = part.poses[row]
    for _ in range(OPTIONS.rounds):
        start = own.apply(homogeneous(part.camera.normalize(pixel)) * depth)[0] if point is None else point
        pixels = {row: pixel}
        for other in others:
            followed = _followed(gray(row), gray(other), pixel, _project(part, other, start))
            if followed is not None:
                pixels[other] = followed
        found = point_of_pixels(part, pixels, depth)
        point = point if found is None else found
        if point is not None:
            depth = float(own.inverse().apply(point[None])[0, 2])
    if point is None:
        u, v = (round(float(value), 1) for value in pixel)
        raise InvalidScanError(
            f"The point at the pixel ({u:g}, {v:g}) of the scale can't be found in enough other pictures: choose a "
            "corner with texture that is in view while the camera moves sideways."
        )
    return point


def depth_near(part: Reconstruction, row: int, pixel: Array) -> float:
    """Return the median depth of the reconstructed features nearest to a pixel (2,) of a picture."""
    points = part.points[part.observations[part.observations[:, 0] == row, 2]]
    in_camera = part.poses[row].inverse().apply(points)
    away = np.linalg.norm(part.camera.project(in_camera) - pixel, axis=1)
    near = np.argsort(np.where(np.isfinite(away), away, np.inf))[: OPTIONS.near_features]
    return float(np.median(in_camera[near, 2]))


def _sharing(part: Reconstruction, row: int) -> list[int]:
    """Return the pictures that share most points with one."""
    own = np.zeros(len(part.points), dtype=bool)
    own[part.observations[part.observations[:, 0] == row, 2]] = True
    shared = part.observations[own[part.observations[:, 2]], 0]
    rows, counts = np.unique(shared[shared != row], return_counts=True)
    return [int(other) for other in rows[np.argsort(-counts, kind="stable")][: OPTIONS.views]]


def _followed(before: Gray, after: Gray, pixel: Array, start: Array) -> Array | None:
    """Return where a pixel (2,) of one picture is in another, from where it is expected; None where it is not found."""
    if not np.isfinite(start).all():
        return None
    here, there = pixel.astype(np.float32).reshape(1, 1, 2), start.astype(np.float32).reshape(1, 1, 2)
    found, status = _flow(before, after, here, there)
    back, returned = _flow(after, before, found, here)
    if not (status[0, 0] and returned[0, 0]) or np.linalg.norm(back - here) > OPTIONS.max_return_px:
        return None
    return np.asarray(found.reshape(2), dtype=np.float64)


def _flow(
    before: Gray, after: Gray, points: NDArray[np.float32], start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points,
        start.copy(),
        winSize=(OPTIONS.window_px, OPTIONS.window_px),
        maxLevel=OPTIONS.levels,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, dtype=np.float32), np.asarray(status, dtype=np.uint8)


def _project(part: Reconstruction, row: int, point: Array) -> Array:
    return np.asarray(part.camera.project(part.poses[row].inverse().apply(point[None]))[0])


def _error_px(part: Reconstruction, row: int, pixel: Array, point: Array) -> float:
    error = float(np.linalg.norm(_project(part, row, point) - pixel))
    return error if np.isfinite(error) else np.inf


def _observations(part: Reconstruction, pixels: Pixels, rows: list[int]) -> Observations:
    inverse = [part.poses[row].inverse() for row in rows]
    return Observations(
        np.zeros(len(rows), np.intp),
        np.concatenate([part.camera.normalize(pixels[row]) for row in rows]),
        np.full(len(rows), part.camera.focal_px),
        np.stack([pose.rotation for pose in inverse]),
        np.stack([pose.translation for pose in inverse]),
    )
