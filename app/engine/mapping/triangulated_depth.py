"""Depths of a scan that has none: its features triangulated by the other views, whose poses are given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.points import View, nearby_views, scaled_px
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.ray_depth import Observations, refine_depth_along_rays
from app.geometry.triangulation import homogeneous, parallax_deg, pixel_depths
from app.limits import limit
from app.vision.features import LocalFeatureExtractor
from app.vision.matching import match_unit_vectors, to_unit_vectors

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangulatedDepthOptions:
    """Which matches determine a depth, and which depths are kept."""

    min_parallax_deg: float = limit(
        0.7,
        "Least angle between the rays of a match that takes part.",
        chosen="By hand: at this angle an error of one pixel changes the depth by about a sixth.",
    )
    max_error_px: float = limit(
        4.0,
        "Largest distance, at 640 pixels of width, of a match from the projection of the point.",
        chosen="By hand: errors of tracked poses are a few pixels between neighbours; a false match is farther off.",
    )
    min_views: int = limit(
        2,
        "Least number of other views that must agree on a point.",
        chosen="By hand: one match may be false.",
    )
    max_median_error_px: float = limit(
        2.5,
        "Largest median reprojection error, at 640 pixels of width, of a point in the other views.",
        chosen="By hand: as that of matches by right poses; more is a false match or a moved thing.",
    )
    max_sigma_ratio: float = limit(
        0.06,
        "Largest standard deviation of a depth, relative to the depth.",
        chosen="By hand: twice that of a depth sensor.",
    )
    free_sigma: float = limit(
        10.0,
        "Standard deviation of the logarithm of the depth that the refinement starts with.",
        chosen="By hand: so large that the start has no weight.",
    )


OPTIONS = TriangulatedDepthOptions()


@dataclass(frozen=True, slots=True)
class _Matches:
    """Matches of a view with others: rows (m,), image-plane coordinates there (m, 2), which view (m,), depths of each
    match alone (m,) and their parallax in degrees (m,)."""

    rows: Rows
    normalized: Array
    views: Rows
    depth_m: Array
    parallax_deg: Array

    def take(self, kept: NDArray[np.bool_]) -> _Matches:
        return _Matches(
            self.rows[kept],
            self.normalized[kept],
            self.views[kept],
            self.depth_m[kept],
            self.parallax_deg[kept],
        )


def with_triangulated_depth(
    views: Mapping[int, View],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> dict[int, View]:
    """Return views whose features without depth have that of their triangulated points, where these are determined.

    A feature is matched with the views near its own. Each match gives a depth; the median weighted by the parallax is
    refined along the ray by all matches that agree with it. The poses are taken to be right.
    """
    rows = sorted(views)
    poses = [views[row].world_from_camera for row in rows]
    units = {row: to_unit_vectors(views[row].features.descriptors, extractor.binary) for row in rows}

    def triangulate(row: int) -> View:
        near = [rows[i] for i in nearby_views(views[row].world_from_camera, poses)]
        others = [(views[other], units[other]) for other in near]
        depth_m = _depths(views[row], units[row], others, camera, extractor)
        known = views[row].depth_m
        return replace(views[row], depth_m=np.where(known > 0, known, depth_m).astype(np.float32))

    return dict(zip(rows, map_in_order(executor, triangulate, rows, "triangulate", progress), strict=True))


def _depths(
    view: View,
    unit: NDArray[np.float32],
    others: Sequence[tuple[View, NDArray[np.float32]]],
    camera: Camera,
    extractor: LocalFeatureExtractor,
) -> Array:
    """Return the depths (n,) of a view's features, 0 where they are not determined."""
    n = len(view.features)
    depth_m = np.zeros(n)
    own = camera.normalize(view.features.keypoints_px)
    matches = _matches(view, unit, own, others, camera, extractor)
    if not len(matches.rows):
        return depth_m
    start = _weighted_median_by_row(matches.rows, matches.depth_m, matches.parallax_deg, n)
    gate_px = scaled_px(OPTIONS.max_error_px, camera)
    rays = homogeneous(own)
    rays_in_world = rays @ view.world_from_camera.rotation.T
    errors_px = _errors_px(matches, start, rays_in_world, view, others, camera)
    matches = matches.take(errors_px < gate_px)
    seen = _observations(matches, others, camera)
    has = np.isfinite(start)
    refined = refine_depth_along_rays(
        rays_in_world,
        view.world_from_camera.translation,
        np.where(has, start, 1.0),
        seen,
        prior_sigma=OPTIONS.free_sigma,
    )
    good = has & (refined.views >= OPTIONS.min_views)
    good &= refined.sigma_m < OPTIONS.max_sigma_ratio * refined.depth_m
    with np.errstate(invalid="ignore"):
        good &= refined.error_px <= scaled_px(OPTIONS.max_median_error_px, camera)
    depth_m[good] = refined.depth_m[good]
    return depth_m


def _matches(
    view: View,
    unit: NDArray[np.float32],
    own: Array,
    others: Sequence[tuple[View, NDArray[np.float32]]],
    camera: Camera,
    extractor: LocalFeatureExtractor,
) -> _Matches:
    """Return the matches that meet the epipolar geometry of the poses with enough parallax."""
    found = [_Matches(np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros(0, np.intp), np.zeros(0), np.zeros(0))]
    gate_px = scaled_px(OPTIONS.max_error_px, camera)
    for number, (other, theirs) in enumerate(others):
        a, b, _ = match_unit_vectors(unit, theirs, extractor.ratio, extractor.binary)
        if not len(a):
            continue
        other_from_view = other.world_from_camera.inverse() @ view.world_from_camera
        there = camera.normalize(other.features.keypoints_px[b])
        depth_m, _ = pixel_depths(own[a], there, other_from_view)
        angle_deg = parallax_deg(own[a], there, other_from_view)
        points = other_from_view.apply(homogeneous(own[a]) * np.nan_to_num(depth_m)[:, None])
        with np.errstate(invalid="ignore", divide="ignore"):
            error_px = camera.focal_px * np.linalg.norm(points[:, :2] / points[:, 2:] - there, axis=1)
            kept = (depth_m > 0) & (points[:, 2] > 0) & (error_px < gate_px)
        kept &= angle_deg >= OPTIONS.min_parallax_deg
        views = np.full(len(a), number, np.intp)
        found.append(_Matches(a, there, views, depth_m, angle_deg).take(kept))
    return _Matches(
        np.concatenate([part.rows for part in found]),
        np.concatenate([part.normalized for part in found]),
        np.concatenate([part.views for part in found]),
        np.concatenate([part.depth_m for part in found]),
        np.concatenate([part.parallax_deg for part in found]),
    )


def _weighted_median_by_row(rows: Rows, values: Array, weights: Array, n: int) -> Array:
    """Return the weighted median (n,) of the values (m,) of each row, NaN for a row without any."""
    out = np.full(n, np.nan)
    order = np.lexsort((values, rows))
    ordered, total = rows[order], np.cumsum(weights[order])
    first = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    last = np.r_[first[1:], len(ordered)] - 1
    before = np.where(first > 0, total[first - 1], 0.0)
    middle = np.searchsorted(total, before + 0.5 * (total[last] - before))
    out[ordered[first]] = values[order][np.clip(middle, first, last)]
    return out


def _errors_px(
    matches: _Matches,
    depth_m: Array,
    rays_in_world: Array,
    view: View,
    others: Sequence[tuple[View, NDArray[np.float32]]],
    camera: Camera,
) -> Array:
    """Return the reprojection errors (m,) of matches by depths (n,) of their features."""
    points = view.world_from_camera.translation + rays_in_world[matches.rows] * depth_m[matches.rows][:, None]
    errors = np.full(len(matches.rows), np.inf)
    for number, (other, _) in enumerate(others):
        of_view = matches.views == number
        there = other.world_from_camera.inverse().apply(points[of_view])
        with np.errstate(invalid="ignore", divide="ignore"):
            projected = there[:, :2] / there[:, 2:]
        away = np.linalg.norm(projected - matches.normalized[of_view], axis=1)
        errors[of_view] = np.where(there[:, 2] > 0, camera.focal_px * away, np.inf)
    return errors


def _observations(
    matches: _Matches, others: Sequence[tuple[View, NDArray[np.float32]]], camera: Camera
) -> Observations:
    poses = [other.world_from_camera.inverse() for other, _ in others]
    return Observations(
        matches.rows,
        matches.normalized,
        np.full(len(matches.rows), camera.focal_px),
        np.stack([pose.rotation for pose in poses])[matches.views],
        np.stack([pose.translation for pose in poses])[matches.views],
    )
