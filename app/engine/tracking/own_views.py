"""What a session has seen itself: views of its own path, by which a phone that comes back corrects odometry.

A loop without a map or a camera: the present frame is matched with an earlier one, whose points odometry had placed
when it had come less far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from app.engine.query.localization import same_place
from app.engine.query.placed import Accuracy
from app.engine.tracking.odometry.points import TrackedPoints
from app.engine.tracking.orb_matches import orb_features
from app.engine.tracking.own_view import OPTIONS, OwnView, SeenAgain, seen_again, view_of
from app.engine.tracking.state import TrackingMemory
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.vision.images import Gray


@dataclass(slots=True)
class OwnViews:
    """The views of a session since its last fix, oldest first."""

    views: list[OwnView] = field(default_factory=list)
    since_look: int = 0

    def keep(
        self, gray: Gray, camera: Camera, memory: TrackingMemory, accuracy: Accuracy, points: TrackedPoints
    ) -> None:
        """Keep a frame as a view if the camera has come far enough from the last one that was kept; `memory` holds its
        pose, and `points` are those that odometry follows in it."""
        pose = memory.frame_from_camera
        if pose is None or not self._is_new(pose, memory):
            return
        view = view_of(gray, camera, memory, accuracy, points)
        if view is not None:
            self.views = [*self.views, view][-OPTIONS.most_views :]

    def _is_new(self, pose: Pose, memory: TrackingMemory) -> bool:
        if not self.views:
            # Where a map shows itself again and again nothing of this is needed.
            return memory.unaided_m >= OPTIONS.spacing_m or memory.unaided_rad >= OPTIONS.spacing_rad
        last = self.views[-1].pose
        moved = position_difference_m(last, pose) >= OPTIONS.spacing_m
        return moved or attitude_difference_rad(last, pose) >= OPTIONS.spacing_rad

    def drop_after(self, view: OwnView) -> None:
        """Drop the views that were kept after one which was seen again: their poses have the error that it shows."""
        self.views = self.views[: next(i for i, kept in enumerate(self.views) if kept is view) + 1]

    def find(
        self,
        gray: Gray,
        camera: Camera,
        near: Pose,
        memory: TrackingMemory,
        accuracy: Accuracy,
        within_m: float,
    ) -> SeenAgain | None:
        """Return an earlier view that a frame near a pose shows again at the end of a loop, None where none is seen or
        none is more accurate; the pose by it is at most `within_m` from `near`, whose accuracy is given. `memory` is of
        the frame before."""
        self.since_look += 1
        if self.since_look < OPTIONS.look_every:
            return None
        tried = self._alike(near, memory, accuracy, within_m)
        if not tried:
            return None
        self.since_look = 0
        found = [seen for seen in _all_seen(tried, gray, camera, near) if _is_near(seen, near, within_m)]
        better = [seen for seen in found if seen.accuracy.position_m < accuracy.position_m]
        return max(better, key=lambda seen: seen.support.inliers, default=None)

    def find_lost(self, gray: Gray, camera: Camera, last: Pose, within_m: float) -> SeenAgain | None:
        """Return an earlier view that the frame of a camera shows which has not been followed since its last pose, and
        may have turned any way; it is at most `within_m` away. None also where two views contradict each other."""
        tried = self._ranked(last, within_m + OPTIONS.reach_m, -1.0)[: OPTIONS.lost_views_tried]
        needed = OPTIONS.lost_inlier_factor * OPTIONS.min_inliers
        found = [
            seen
            for seen in (_all_seen(tried, gray, camera, None) if tried else [])
            if _is_near(seen, last, within_m) and seen.support.inliers >= needed
        ]
        best = max(found, key=lambda seen: seen.support.inliers, default=None)
        if best is None or any(not same_place(seen.pose, best.pose) for seen in found):
            return None
        return best

    def _alike(
        self, near: Pose, memory: TrackingMemory, accuracy: Accuracy, within_m: float
    ) -> list[OwnView]:
        """Return the earlier views that may show the same and are more accurate, the likeliest first."""
        largest_m = OPTIONS.max_sigma_ratio * accuracy.position_m
        ranked = self._ranked(near, within_m + OPTIONS.reach_m, OPTIONS.min_cosine)
        better = [view for view in ranked if view.accuracy.position_m <= largest_m]
        return [view for view in better if _is_loop(view, near, memory)][: OPTIONS.views_tried]

    def _ranked(self, near: Pose, within_m: float, min_cosine: float) -> list[OwnView]:
        """Return the views near a pose, those first that show the most of what it sees."""
        ranked: list[tuple[float, int]] = []
        for row, view in enumerate(self.views):
            away_m = position_difference_m(view.pose, near)
            cosine = float(view.pose.rotation[:, 2] @ near.rotation[:, 2])
            if away_m <= within_m and cosine >= min_cosine:
                ranked.append((away_m + OPTIONS.turn_m * (1.0 - cosine), row))
        return [self.views[row] for _, row in sorted(ranked)]


def _is_loop(view: OwnView, near: Pose, memory: TrackingMemory) -> bool:
    """Whether the way since a view is much longer than how far the camera is from it."""
    came_m, turned_rad = (
        memory.unaided_m - view.memory.unaided_m,
        memory.unaided_rad - view.memory.unaided_rad,
    )
    by_path = OPTIONS.loop_m + OPTIONS.loop_ratio * position_difference_m(view.pose, near)
    by_turn = OPTIONS.loop_rad + OPTIONS.loop_ratio * attitude_difference_rad(view.pose, near)
    return came_m >= by_path or turned_rad >= by_turn


def _is_near(seen: SeenAgain, near: Pose, within_m: float) -> bool:
    return position_difference_m(seen.pose, near) <= within_m


def _all_seen(views: Sequence[OwnView], gray: Gray, camera: Camera, near: Pose | None) -> list[SeenAgain]:
    """Return what a frame shows of some views."""
    pixels, descriptors = orb_features(gray)
    if len(pixels) < OPTIONS.min_inliers:
        return []
    found = [seen_again(view, pixels, descriptors, camera, near) for view in views]
    return [seen for seen in found if seen is not None]
