"""Visual odometry: PnP on points that a fix gave or that were triangulated since (C 5.1.1-5.1.2).

All of it is metric from the first frame on: a fix brings points with their places in the world, and new points
are placed by poses that come of those. No scale is ever assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.query.accuracy import accuracy_of
from app.engine.query.placed import Accuracy, Support
from app.engine.query.verification import coverage
from app.engine.tracking.fix import Fix
from app.engine.tracking.frame import TrackingFrame, find_corners, follow
from app.engine.tracking.odometry.monitor_view import MonitorView, SeenByMonitor
from app.engine.tracking.odometry.options import OPTIONS
from app.engine.tracking.odometry.points import OPTIONS as POINT_OPTIONS
from app.engine.tracking.odometry.points import TrackedPoints
from app.engine.tracking.odometry.turning import shift_between, turned
from app.engine.tracking.odometry.window import KeyView, Window
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.pose_refinement import refine_pose
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose

# From pixels (n, 2), their camera and its pose to how far away things are expected to be along the rays (n,), metres.
ExpectedDistances = Callable[[NDArray[np.float64], Camera, Pose], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """A pose by odometry: one sigma of it by the points it was estimated from, how many agreed of how many, and
    which share of the image they cover."""

    frame_from_camera: Pose
    accuracy: Accuracy
    support: Support
    coverage: float
    from_fix: int

    @property
    def can_be_trusted(self) -> bool:
        """Whether enough points agree, spread over the image."""
        inliers, matches = self.support.inliers, self.support.matches
        enough = inliers >= OPTIONS.min_inliers and inliers >= OPTIONS.min_inlier_ratio * matches
        return enough and self.coverage >= OPTIONS.min_coverage


class Odometry:
    """Follows points from frame to frame. Knows nothing of maps."""

    def __init__(
        self,
        frame: TrackingFrame,
        fix: Fix | None,
        lens: Lens | None = None,
        *,
        pose: Pose | None = None,
        expected: ExpectedDistances | None = None,
    ) -> None:
        """Start from a fix. Of a `lens` that isn't stated `lens` becomes what keyframes and a monitoring camera's view
        show of it; cameras that are given are behind it as it is.

        With `expected` distances new points begin there, not where their neighbours are; then odometry can start from a
        `pose` without a fix, and its scale is that of the expected distances.
        """
        self.lens = lens
        self._gray = frame.gray
        self._points = self._by_two_views = TrackedPoints.none()
        self._next_id = 0
        self._pose = fix.frame_from_camera if fix is not None else pose or Pose.identity()
        self._window = Window()
        self._anchors: tuple[str, ...] = ()
        self._scale_sigma = np.inf
        self._since_keyframe = 0
        self.expected = expected
        if fix is not None:
            self.absorb(fix)
            self._refill(fix.camera, fix.frame_from_camera)

    @property
    def size_px(self) -> tuple[int, int]:
        """The size of the frames that can be followed."""
        return self._gray.shape[1], self._gray.shape[0]

    @property
    def points(self) -> TrackedPoints:
        """The points that are followed, as they are in the present frame."""
        return self._points

    def absorb(self, fix: Fix) -> None:
        """Take the points of a fix of the present frame in place of those of earlier fixes.

        What was placed by odometry's own pose of this frame moves along with the correction.
        """
        correction = fix.frame_from_camera @ self._pose.inverse()
        own = self._points.take(~self._points.from_fix).moved(correction)
        rows = np.argsort(fix.point_sigma_m)[: OPTIONS.most_fixed]
        self._points, self._pose = self._points_of(fix, rows).joined(own), fix.frame_from_camera
        self._window.move(correction)
        if fix.seen is not None and fix.scale_sigma > 0:
            self._window.monitor = MonitorView.of(fix.seen, self._by_two_views.ids, rows)
            self._anchors = fix.anchors
        self._since_keyframe = OPTIONS.keyframe_every

    def move_to(self, pose: Pose) -> None:
        """Put the present frame's camera where it is now known to be; all that odometry has placed moves along."""
        correction = pose @ self._pose.inverse()
        self._points, self._pose = self._points.moved(correction), pose
        self._by_two_views = self._by_two_views.moved(correction)
        self._window.move(correction)

    def _points_of(self, fix: Fix, rows: NDArray[np.intp]) -> TrackedPoints:
        ids, pixels, points = self._new_ids(len(rows)), fix.points_px[rows], fix.points_in_frame[rows]
        pose = fix.frame_from_camera
        if fix.scale_sigma > 0:
            # Two views place points along their rays as well as they know how they stand to each other.
            distances_m = np.linalg.norm(points - pose.translation, axis=1)
            self._by_two_views = TrackedPoints.new(
                ids, pixels, fix.camera, pose, distances_m, OPTIONS.two_view_sigma
            )
            return self._by_two_views
        return TrackedPoints.fixed(ids, pixels, points, fix.point_sigma_m[rows], pose)

    def distance_ratio(self, fix: Fix) -> float | None:
        """Return how many times as far as a fix of the present frame odometry has what both see, or None when that is
        too little: the median over the points of both that are close together in the picture."""
        placed = self._points.take(self._points.is_placed)
        if not len(placed) or not len(fix.points_px):
            return None
        apart_px, nearest = cKDTree(placed.pixels).query(fix.points_px)
        close = np.flatnonzero(apart_px < OPTIONS.same_spot_tangent * fix.camera.focal_px)
        if len(close) < OPTIONS.min_compared:
            return None
        same = placed.take(np.asarray(nearest)[close])
        ours = np.linalg.norm(same.points_in_frame - self._pose.translation, axis=1)
        theirs = np.linalg.norm(fix.points_in_frame[close] - fix.frame_from_camera.translation, axis=1)
        return float(np.exp(np.median(np.log(ours / theirs))))

    def rescale(self, factor: float, pose: Pose) -> None:
        """Make all lengths so many times as long, and put the present frame's camera where it is now known to be."""
        centre, correction = self._pose.translation, pose @ self._pose.inverse()
        self._points = self._points.scaled(centre, factor).moved(correction)
        self._window.rescale(centre, factor, correction)
        self._by_two_views = self._by_two_views.scaled(centre, factor).moved(correction)
        self._pose = pose

    def adjust_with(self, fix: Fix, ratio: float) -> float | None:
        """Adjust what was followed so far together with what a monitoring camera sees of it by a fix of the present
        frame, and follow what it sees besides; `ratio` is how many times as far as the fix odometry has what both see.

        Returns one sigma of the scale, as a share, by the distances that the monitoring camera knows; None where it
        knows none of what is seen, or is another one than the first.
        """
        monitor = self._window.monitor
        if fix.seen is None or fix.seen.scale_of is None or monitor is None or fix.anchors != self._anchors:
            return None
        self._window.monitor = monitor.with_more(self._also_seen(fix, fix.seen, ratio))
        self._since_keyframe = 0
        self._add_keyframe(fix.camera)
        return self._scale_sigma if np.isfinite(self._scale_sigma) else None

    def _also_seen(self, fix: Fix, seen: SeenByMonitor, ratio: float) -> MonitorView:
        """Return what a monitoring camera sees by a fix: points that are followed already, and others from now on."""
        apart_px, near = cKDTree(self._points.pixels).query(fix.points_px)
        same = np.flatnonzero(apart_px < OPTIONS.same_point_tangent * fix.camera.focal_px)
        new = np.flatnonzero(apart_px > OPTIONS.new_point_tangent * fix.camera.focal_px)[
            : max(OPTIONS.most_points - len(self._points), 0)
        ]
        ids, first = np.unique(self._points.ids[np.asarray(near)[same]], return_index=True)
        distances_m = ratio * np.linalg.norm(
            fix.points_in_frame[new] - fix.frame_from_camera.translation, axis=1
        )
        added = TrackedPoints.new(
            self._new_ids(len(new)),
            fix.points_px[new],
            fix.camera,
            self._pose,
            distances_m,
            OPTIONS.two_view_sigma,
        )
        self._points, self._by_two_views = self._points.joined(added), self._by_two_views.joined(added)
        return MonitorView.of(seen, np.concatenate([ids, added.ids]), np.concatenate([same[first], new]))

    def beside_monitor(self, position: NDArray[np.float64], turn: NDArray[np.float64]) -> Pose:
        """Return the present frame's pose when all is turned by a rotation (3, 3) about the monitoring camera, and that
        is put where it is known to be (3,)."""
        assert self._window.monitor is not None  # noqa: S101 - asked after `adjust_with`
        offset = self._pose.translation - self._window.monitor.seen.frame_from_camera.translation
        return Pose(turn @ self._pose.rotation, position + turn @ offset)

    def _new_ids(self, count: int) -> NDArray[np.int64]:
        self._next_id += count
        return np.arange(self._next_id - count, self._next_id)

    def step(self, frame: TrackingFrame, camera: Camera, predicted: Pose) -> OdometryStep | None:
        """Follow all points into a frame and return its pose; None when there is none at all."""
        moved, found = self._follow(frame, camera)
        self._gray = frame.gray
        points = self._points.take(found)
        points.pixels = moved[found]
        self._points = points
        pose = self._estimate(points, camera, predicted)
        if pose is None:
            return None
        across_m = points.sigma_across_m(pose.translation)
        agree = self._agreeing(points, across_m, camera, pose)
        inliers = points.take(agree)
        if len(inliers) < 4:
            return None
        accuracy = accuracy_of(inliers.pixels, inliers.points_in_frame, across_m[agree], camera, pose)
        self._points, self._pose = inliers, pose
        return OdometryStep(
            pose,
            accuracy,
            Support(len(inliers), len(points)),
            coverage(inliers.pixels, (camera.width, camera.height)),
            int(np.count_nonzero(inliers.from_fix)),
        )

    def _follow(self, frame: TrackingFrame, camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Follow all points into a frame, beginning where a turn of the camera has moved them."""
        pixels = self._points.pixels
        shift_px = shift_between(self._gray, frame.gray)
        if shift_px is None:
            return follow(self._gray, frame, pixels)
        moved, found = follow(self._gray, frame, pixels, turned(pixels, camera, shift_px))
        if np.count_nonzero(found) >= OPTIONS.enough_found_share * len(pixels):
            return moved, found
        straight, also = follow(self._gray, frame, pixels)
        more = np.count_nonzero(also) > np.count_nonzero(found)
        return (straight, also) if more else (moved, found)

    def _estimate(self, points: TrackedPoints, camera: Camera, predicted: Pose) -> Pose | None:
        """Return the pose by the points that are placed well, then by all, each as far as it can be trusted."""
        if self._has_enough_fixed(points, camera):
            points = points.take(points.from_fix)
        placed = points.take(points.is_placed)
        first = estimate_pose_lo_ransac(
            placed.pixels,
            placed.points_in_frame,
            camera,
            max_error_px=OPTIONS.max_error_tangent * camera.focal_px,
            max_iterations=300,
            min_iterations=20,
            prior=predicted,
        )
        if first is None:
            return None
        pose = first.world_from_camera
        across_m = points.sigma_across_m(pose.translation)
        agree = self._agreeing(points, across_m, camera, pose)
        some = points.take(agree)
        try:
            return refine_pose(
                some.pixels,
                some.points_in_frame,
                camera,
                pose,
                weights=_weights(some, across_m[agree], pose),
                max_steps=6,
            )
        except DegenerateGeometryError:
            return None

    def _agreeing(
        self, points: TrackedPoints, across_m: NDArray[np.float64], camera: Camera, pose: Pose
    ) -> NDArray[np.bool_]:
        errors = reprojection_errors_px(points.pixels, points.points_in_frame, camera, pose)
        distances = np.maximum(np.linalg.norm(points.points_in_frame - pose.translation, axis=1), 1e-6)
        limits = camera.focal_px * np.hypot(
            OPTIONS.max_error_tangent, np.minimum(across_m / distances, 4 * OPTIONS.max_error_tangent) * 2
        )
        return np.asarray(errors <= limits)

    def learn(self, camera: Camera) -> Pose:
        """Better the points by the present frame, whose pose is trusted, and look for new ones.

        Every few frames the last keyframes are adjusted together; returns the pose of this frame after that.
        """
        self._points.observe(camera, self._pose)
        self._since_keyframe += 1
        if self._since_keyframe >= OPTIONS.keyframe_every:
            self._since_keyframe = 0
            self._add_keyframe(camera)
        self._refill(camera, self._pose)
        return self._pose

    def _add_keyframe(self, camera: Camera) -> None:
        points = self._points
        prior, prior_sigma_m = (
            points.points_in_frame,
            np.where(points.from_fix, np.hypot(points.across_m, OPTIONS.min_fix_sigma_m), np.inf),
        )
        # Where two views placed points they still hold the scale, together, when each has found a better place.
        _, now, then = np.intersect1d(points.ids, self._by_two_views.ids, return_indices=True)
        prior[now] = self._by_two_views.points_in_frame[then]
        prior_sigma_m[now] = OPTIONS.two_view_sigma / self._by_two_views.inverse_m[then]
        self._window.add(
            KeyView(self._pose, points.ids, points.pixels), points.points_in_frame, prior, prior_sigma_m
        )
        if self._has_enough_fixed(points, camera):
            return
        seen_often, self.lens = self._window.adjust(camera, self.lens)
        adjusted = np.intersect1d(seen_often, points.ids)
        order = np.argsort(points.ids)
        rows = order[np.searchsorted(points.ids[order], adjusted)]
        places = self._window.points_in_frame[np.searchsorted(self._window.ids, adjusted)]
        own = ~points.from_fix[rows]
        points.place(rows[own], places[own])
        self._pose = self._window.views[-1].frame_from_camera
        self._keep_known_distances()

    def _keep_known_distances(self) -> None:
        """Make all lengths what the distances say that a monitoring camera knows, about where that is."""
        known, monitor = self._window.scale(), self._window.monitor
        if known is None or monitor is None or known[1] > OPTIONS.max_scale_sigma_ratio * self._scale_sigma:
            return
        factor, self._scale_sigma = float(np.exp(known[0])), min(known[1], self._scale_sigma)
        centre = monitor.seen.frame_from_camera.translation
        here = centre + factor * (self._pose.translation - centre)
        self.rescale(factor, Pose(self._pose.rotation, here))

    def _has_enough_fixed(self, points: TrackedPoints, camera: Camera) -> bool:
        """Whether points of a fix alone tell the pose. They don't drift: then the others say nothing better."""
        pixels = points.pixels[points.from_fix]
        spread = coverage(pixels, (camera.width, camera.height))
        return len(pixels) >= OPTIONS.enough_fixed and spread >= OPTIONS.enough_coverage

    def _refill(self, camera: Camera, pose: Pose) -> None:
        if len(self._points) >= OPTIONS.refill_share * OPTIONS.wanted_points:
            return
        corners = find_corners(self._gray, self._points.pixels, OPTIONS.wanted_points - len(self._points))
        if self.expected is not None and len(corners):
            expected_m, share = self.expected(corners, camera, pose), OPTIONS.expected_depth_sigma
            fresh = TrackedPoints.new(self._new_ids(len(corners)), corners, camera, pose, expected_m, share)
            self._points = self._points.joined(fresh)
            return
        placed = self._points.take(self._points.is_placed)
        if len(placed) and len(corners):
            distances = np.linalg.norm(placed.points_in_frame - pose.translation, axis=1)
            _, near = cKDTree(placed.pixels).query(corners, k=min(OPTIONS.neighbours, len(placed)))
            around = np.median(distances[near.reshape(len(corners), -1)], axis=1)
            fresh = TrackedPoints.new(self._new_ids(len(corners)), corners, camera, pose, around)
            self._points = self._points.joined(fresh)


def _weights(points: TrackedPoints, across_m: NDArray[np.float64], pose: Pose) -> NDArray[np.float64]:
    """Return one over the variance of each point's pixel, 1 for a point whose place is certain."""
    distances = np.maximum(np.linalg.norm(points.points_in_frame - pose.translation, axis=1), 1e-6)
    # What is not placed yet is taken to be as far as its neighbours: if they all are nearer, it is one error.
    alike = np.where(points.is_placed, 1.0, np.count_nonzero(~points.is_placed))
    return np.asarray(1.0 / (1.0 + alike * (across_m / distances / POINT_OPTIONS.flow_sigma_tangent) ** 2))
