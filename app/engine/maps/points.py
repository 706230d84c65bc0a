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
from app.vision.features import LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors

# Views further apart share little; nearer ones than this many are enough to average out the noise.
MAX_BASELINE_M = 1.5
MIN_AXES_COSINE = float(np.cos(np.radians(35)))
MAX_VIEWS = 20
# A match that far from where depth puts the point is a wrong match, not a wrong depth.
GATE_PX = 12.0
# With this many views in disagreement about a point, the point is no good for a pose.
MAX_ERROR_PX = 6.0


@dataclass(frozen=True, slots=True)
class View:
    """One frame of the scan: pose, features, and the features' depths (n,) in metres, 0 = none."""

    world_from_camera: Pose
    features: LocalFeatures
    depth_m: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class MapPoints:
    """A keyframe's features that have a point: features, points (n, 3) in the world, sigma (n,) in metres, and how
    many other views (n,) of the scan saw each."""

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


def nearby_views(keyframe: Pose, views: Sequence[Pose]) -> list[int]:
    """Return the views that can see what the keyframe sees, at most `MAX_VIEWS`, spread over the distances."""
    positions = np.stack([view.translation for view in views])
    axes = np.stack([view.rotation[:, 2] for view in views])
    distances = np.linalg.norm(positions - keyframe.translation, axis=1)
    near = (distances < MAX_BASELINE_M) & (axes @ keyframe.rotation[:, 2] > MIN_AXES_COSINE)
    candidates = np.flatnonzero(near & (distances > 1e-6))
    ordered = candidates[np.argsort(distances[candidates])]
    if len(ordered) <= MAX_VIEWS:
        return [int(i) for i in ordered]
    picks = np.unique(np.linspace(0, len(ordered) - 1, MAX_VIEWS).round().astype(int))
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
    """Return a keyframe's points by its own depth and by the matches with other views."""
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
    keep = ~((refined.views >= 3) & (refined.error_px > MAX_ERROR_PX))
    return MapPoints(own.features, points, refined.sigma_m, refined.views).take(keep)


def close_matches(
    own: MapPoints, other: View, camera: Camera, ratio: float, binary: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which features (n,) of a keyframe match which (n,) of another view, near where its pose puts them."""
    mine = to_unit_vectors(own.features.descriptors, binary)
    a, b, _ = match_unit_vectors(mine, to_unit_vectors(other.features.descriptors, binary), ratio, binary)
    predicted = camera.project(other.world_from_camera.inverse().apply(own.points_in_world[a]))
    gate = GATE_PX * max(camera.width, camera.height) / 640.0
    with np.errstate(invalid="ignore"):
        close = np.linalg.norm(predicted - other.features.keypoints_px[b], axis=1) < gate
    return a[close], b[close]


def observations_by(
    others: Sequence[View], own: MapPoints, camera: Camera, ratio: float, binary: bool
) -> Observations:
    """Return where other views see a keyframe's points: matches that lie near where their poses put the points."""
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
