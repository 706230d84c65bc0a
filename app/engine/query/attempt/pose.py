"""The pose that the matches of a picture with a map agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.camera import fit_query_camera
from app.engine.query.hypothesis import Hypothesis, seen_from_one_side
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.query import Query
from app.engine.query.second.look import SecondMatcher
from app.engine.query.settings import LocalizerSettings
from app.engine.query.verification import Limits, coverage
from app.geometry.camera import Camera
from app.geometry.estimators.interface import MIN_POINTS
from app.geometry.focal import ApproximateCamera, find_camera
from app.geometry.lens import Lens
from app.geometry.pnp import PnpEstimate, estimate_pose_epnp_lm, estimate_poses_lo_ransac
from app.geometry.se3 import Pose

Matcher = QueryMatcher | SecondMatcher


def poses_in_map(
    artifact: MapArtifact,
    matches: Matches,
    cameras: Sequence[Camera],
    max_error: float,
    max_iterations: int,
    prior: Pose | None = None,
) -> list[PnpEstimate | None]:
    """Return the pose that most matches agree on by each of several cameras, None where too few do.

    `max_error` is the inlier limit as an angle (tangent). A wall in a mirror is the wall seen from behind: a point
    counts only when seen from the side that its keyframe saw it from.
    """
    found = estimate_poses_lo_ransac(
        matches.points_px,
        matches.points_in_world,
        [(camera, max_error * camera.focal_px) for camera in cameras],
        max_iterations=max_iterations,
        prior=prior,
    )
    centres = artifact.arrays.positions[matches.keyframes]
    poses: list[PnpEstimate | None] = []
    for each in found:
        if each is not None:
            front = seen_from_one_side(matches.points_in_world, centres, each.world_from_camera.translation)
            each = replace(each, inlier_mask=each.inlier_mask & front)  # noqa: PLW2901 - the same pose
        poses.append(each if each is not None and np.count_nonzero(each.inlier_mask) >= MIN_POINTS else None)
    return poses


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """Finds poses in a map, by settings and the limits of a trusted pose."""

    map: OpenMap
    settings: LocalizerSettings
    limits: Limits

    def estimate(self, matches: Matches, camera: Camera, prior: Pose | None = None) -> Hypothesis | None:
        """Return the pose of a camera that most matches agree on, None when too few do; `prior` is tried first."""
        (found,) = self.poses(matches, [camera], self.settings.max_iterations, prior)
        return None if found is None else Hypothesis.of(found, matches)

    def poses(
        self, matches: Matches, cameras: Sequence[Camera], max_iterations: int, prior: Pose | None = None
    ) -> list[PnpEstimate | None]:
        """Return the pose by each of several cameras that most matches agree on, None where too few do."""
        tangent = self.settings.max_error_tangent
        if self.settings.estimator == "lo_ransac":
            return poses_in_map(self.map.artifact, matches, cameras, tangent, max_iterations, prior)
        pixels, points = matches.points_px, matches.points_in_world
        return [
            estimate_pose_epnp_lm(pixels, points, camera, max_error_px=tangent * camera.focal_px)
            for camera in cameras
        ]

    def best(
        self, matcher: Matcher, matches: Matches, camera: Camera, rival: Hypothesis | None = None
    ) -> Hypothesis | None:
        """Return the pose that most matches agree on, or refine the one of a rival.

        Unless the first estimate is convincing it is made again, with the keyframes that must see the same by it:
        what retrieval missed is not lost. A rival always is, to be judged by all that speaks for it.
        """
        settings, found = self.settings, rival or self.estimate(matches, camera)
        if found is None or not settings.covisible:
            return found
        enough = settings.convincing_inliers_factor * self.limits.min_inliers
        if rival is None and found.inlier_features >= enough:
            size_px = camera.width, camera.height
            if coverage(found.inliers.points_px, size_px) >= settings.convincing_coverage:
                return found
        allowed = matcher.query.allowed
        more = self.map.retrieval.covisible(found.pose, settings.covisible, matcher.matched, allowed)
        return self.estimate(Matches.merge([matches, matcher.match(more)]), camera, found.pose)

    def find_camera(self, matches: Matches, query: Query) -> Camera | None:
        """Return the pinhole of any focal length that most matches agree with, near the one that is known roughly."""
        near = query.known if isinstance(query.known, ApproximateCamera) else None
        points, threshold = (matches.points_px, matches.points_in_world), self.settings.max_error_tangent
        return find_camera(*points, *query.size_px, threshold, max(self.limits.min_inliers, 8), near)

    def fit_camera(
        self, best: Hypothesis, camera: Camera, known: Camera | ApproximateCamera | None, lens: Lens | None
    ) -> tuple[Camera, Hypothesis | None]:
        """Fit the camera to all inliers, and the pose again."""
        fitted = fit_query_camera(best.inliers, best.estimate, camera, known, lens)
        if fitted is None:
            return camera, None
        return fitted, self.estimate(best.matches, fitted, best.pose)
