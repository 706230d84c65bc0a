"""The 3-D points of keyframe features: from depth, then refined by the other views of the scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.ray_depth import OPTIONS as RAY_DEPTH
from app.geometry.ray_depth import Observations, refine_depth_along_rays
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors

# Limits in pixels of this room are given for an image of this width.
REFERENCE_WIDTH_PX = 640.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PointOptions:
    """Which views refine a keyframe's points, and which of the results are kept."""

    max_baseline_m: float = limit(
        1.5,
        "Largest distance between a keyframe and a view that refines its points.",
        chosen="By hand: views further apart share few features.",
    )
    max_axes_angle_deg: float = limit(
        35.0,
        "Largest angle between the optical axes of a keyframe and of a view that refines its points.",
        chosen="By hand: views further apart share few features.",
    )
    max_views: int = limit(
        20,
        "Largest number of views that refine the points of one keyframe.",
        chosen="By hand: these are enough to average out the noise; more cost time.",
    )
    match_gate_px: float = limit(
        12.0,
        "Largest distance, at 640 pixels of width, between a matched feature and the projection of the point.",
        chosen="By hand: the error of poses and depth is a few pixels, and a false match is this near by chance "
        "once in 700 matches (docs/calibration.md).",
    )
    max_median_error_px: float = limit(
        6.0,
        "Largest median reprojection error of a refined point in the other views; above it the point is dropped.",
        chosen="By hand; no measurement is recorded.",
    )
    min_views_to_drop: int = limit(
        3,
        "Least number of views whose reprojection errors can drop a point.",
        chosen="By hand: the median of two errors is their mean, which one false match decides.",
    )


OPTIONS = PointOptions()
MIN_AXES_COSINE = float(np.cos(np.radians(OPTIONS.max_axes_angle_deg)))


@dataclass(frozen=True, slots=True)
class View:
    """One frame of the scan: pose, features, and the features' depths (n,) in metres, 0 = none."""

    world_from_camera: Pose
    features: LocalFeatures
    depth_m: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class MapPoints:
    """A keyframe's features that have a point: features, points (n, 3) in the world, their standard deviations (n,)
    in metres, and the number of other views (n,) of the scan that saw each."""

    features: LocalFeatures
    points_in_world: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    views: NDArray[np.intp]

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> MapPoints:
        """Return the features of the given rows."""
        return MapPoints(
            self.features.take(rows), self.points_in_world[rows], self.sigma_m[rows], self.views[rows]
        )

    @staticmethod
    def merge(parts: Sequence[MapPoints]) -> MapPoints:
        """Return the points of all parts, at least one."""
        features = LocalFeatures(
            np.concatenate([part.features.keypoints_px for part in parts]),
            np.concatenate([part.features.descriptors for part in parts]),
        )
        return MapPoints(
            features,
            np.concatenate([part.points_in_world for part in parts]),
            np.concatenate([part.sigma_m for part in parts]),
            np.concatenate([part.views for part in parts]),
        )


def scaled_px(length_px: float, camera: Camera) -> float:
    """Return a length in pixels of a camera's images that is `length_px` at the width of `REFERENCE_WIDTH_PX`."""
    return length_px * max(camera.width, camera.height) / REFERENCE_WIDTH_PX


def nearby_views(keyframe: Pose, views: Sequence[Pose]) -> list[int]:
    """Return the rows of the views that can see what the keyframe sees.

    At most `OPTIONS.max_views`, evenly spread over the views in the order of their distances.
    """
    positions = np.stack([view.translation for view in views])
    axes = np.stack([view.rotation[:, 2] for view in views])
    distances = np.linalg.norm(positions - keyframe.translation, axis=1)
    near = (distances < OPTIONS.max_baseline_m) & (axes @ keyframe.rotation[:, 2] > MIN_AXES_COSINE)
    candidates = np.flatnonzero(near & (distances > 1e-6))
    ordered = candidates[np.argsort(distances[candidates])]
    if len(ordered) <= OPTIONS.max_views:
        return [int(i) for i in ordered]
    picks = np.unique(np.linspace(0, len(ordered) - 1, OPTIONS.max_views).round().astype(int))
    return [int(i) for i in ordered[picks]]


def points_from_depth(view: View, camera: Camera) -> MapPoints:
    """Return a keyframe's points by its own depth alone (A eq. 5-9)."""
    valid = view.depth_m > 0
    features = view.features.take(valid)
    in_camera = camera.unproject(features.keypoints_px, view.depth_m[valid])
    points = view.world_from_camera.apply(in_camera)
    sigma_m = RAY_DEPTH.prior_sigma_ratio * in_camera[:, 2]
    return MapPoints(features, points, sigma_m, np.zeros(len(features), np.intp))


def refined_points(
    view: View, others: Sequence[View], camera: Camera, ratio: float, binary: bool
) -> MapPoints:
    """Return a keyframe's points by its own depth and by the matches with other views.

    `ratio` is the threshold of the ratio test, `binary` whether descriptors are compared by Hamming distance.
    """
    own = points_from_depth(view, camera)
    if len(own.features) == 0:
        return own
    depth_m = view.depth_m[view.depth_m > 0].astype(np.float64)
    rays = camera.unproject(own.features.keypoints_px, np.ones(len(depth_m)))
    rays_in_world = rays @ view.world_from_camera.rotation.T
    seen = observations_by(others, own, camera, ratio, binary)
    if len(seen) == 0:
        return own
    refined = refine_depth_along_rays(rays_in_world, view.world_from_camera.translation, depth_m, seen)
    points = view.world_from_camera.translation + refined.depth_m[:, None] * rays_in_world
    enough = refined.views >= OPTIONS.min_views_to_drop
    keep = ~(enough & (refined.error_px > OPTIONS.max_median_error_px))
    return MapPoints(own.features, points, refined.sigma_m, refined.views).take(keep)


def close_matches(
    own: MapPoints, other: View, camera: Camera, ratio: float, binary: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the matches of a keyframe's features with another view's: rows (n,) of both.

    Only those within the match gate of the point's projection are returned. A match further away is taken to be
    false: an error of the depth moves the projection less.
    """
    mine = to_unit_vectors(own.features.descriptors, binary)
    a, b, _ = match_unit_vectors(mine, to_unit_vectors(other.features.descriptors, binary), ratio, binary)
    predicted = camera.project(other.world_from_camera.inverse().apply(own.points_in_world[a]))
    gate_px = scaled_px(OPTIONS.match_gate_px, camera)
    with np.errstate(invalid="ignore"):
        close = np.linalg.norm(predicted - other.features.keypoints_px[b], axis=1) < gate_px
    return a[close], b[close]


def observations_by(
    others: Sequence[View], own: MapPoints, camera: Camera, ratio: float, binary: bool
) -> Observations:
    """Return the observations of a keyframe's points in other views: their close matches, with the views' poses."""
    rows, normalized, poses = [], [], []
    for other in others:
        a, b = close_matches(own, other, camera, ratio, binary)
        rows.append(a)
        normalized.append(camera.normalize(other.features.keypoints_px[b]))
        poses.append((other.world_from_camera.inverse(), len(a)))
    if not rows:
        return Observations(
            np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3))
        )
    counts = [count for _, count in poses]
    return Observations(
        np.concatenate(rows),
        np.concatenate(normalized),
        np.full(sum(counts), camera.focal_px),
        np.repeat(np.stack([pose.rotation for pose, _ in poses]), counts, axis=0),
        np.repeat(np.stack([pose.translation for pose, _ in poses]), counts, axis=0),
    )
