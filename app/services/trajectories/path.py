"""The frames of a session since its last fix: what the next fix, or a loop of its own, corrects of its trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import floor_of, plan_point
from app.engine.query.placed import Accuracy
from app.engine.tracking.memory import pose_to_json
from app.engine.tracking.tracked import Tracked
from app.engine.tracking.trajectory import Anchored, corrected_path, largest_change_m
from app.geometry.se3 import Pose
from app.limits import limit
from app.storage.sessions import SessionPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class PathOptions:
    """When a trajectory is corrected."""

    min_change_m: float = limit(
        0.01,
        "A correction that moves no pose by more is not stored.",
        chosen="By hand: below what a plan shows, and most fixes of a session that the map shows correct less.",
    )
    max_frames: int = limit(
        1500,
        "Frames since the last fix that are corrected at most.",
        chosen="By hand: a minute or two of a video; bounds the time of one answer.",
    )


OPTIONS = PathOptions()


@dataclass(slots=True)
class PathSinceFix:
    """The last fix with the frames that odometry placed after it, and the points of the trajectory that they are.

    Kept in memory alone: after a restart the path up to there stays as it was answered.
    """

    first: Anchored | None = None
    frames: list[tuple[SessionPoint, Pose]] = field(default_factory=list)

    def copy(self) -> PathSinceFix:
        """Return a path that goes on by itself."""
        return PathSinceFix(self.first, list(self.frames))

    def add(self, tracked: Tracked, point: SessionPoint) -> list[tuple[SessionPoint, Pose]]:
        """Add a frame with the point that it is; return the earlier points that its fix corrects, with their poses."""
        pose = None if tracked.placed is None else tracked.placed.world_from_camera
        if pose is None or tracked.accuracy is None:
            self.first, self.frames = None, []
            return []
        if tracked.method == "odometry":
            corrected = self._closed(tracked)
            if self.first is not None and len(self.frames) < OPTIONS.max_frames:
                self.frames.append((point, pose))
            return corrected
        # What is not known of the camera is the same at both ends.
        fix = Anchored(pose, tracked.accuracy if tracked.fix is None else tracked.fix.accuracy)
        corrected = self._corrected(fix, tracked.by_odometry)
        self.first, self.frames = fix, []
        return corrected

    def _closed(self, tracked: Tracked) -> list[tuple[SessionPoint, Pose]]:
        """Return the points that a loop of the session's own corrects: those since the view that is seen again."""
        seen, by_odometry = tracked.seen_again, tracked.by_odometry
        if seen is None or by_odometry is None or tracked.placed is None:
            return []
        then = next((row for row, (point, _) in enumerate(self.frames) if point.time_s == seen.time_s), None)
        if then is None or len(self.frames) == OPTIONS.max_frames:
            # The view is of a path that was given up, or frames are missing between it and now.
            return []
        pose, since = self.frames[then][1], self.frames[then + 1 :]
        # What the view's own pose is off by moves the whole loop.
        first = Anchored(pose, Accuracy(0.0, 0.0))
        last = Anchored(tracked.placed.frame_from_camera, seen.relative)
        path = [pose, *(pose for _, pose in since), by_odometry]
        corrected = corrected_path(path, first, last)[1:-1]
        if largest_change_m(path[1:-1], corrected) <= OPTIONS.min_change_m:
            return []
        moved = [(point, pose) for (point, _), pose in zip(since, corrected, strict=True)]
        self.frames[then + 1 :] = moved
        return moved

    def _corrected(self, fix: Anchored, by_odometry: Pose | None) -> list[tuple[SessionPoint, Pose]]:
        if self.first is None or by_odometry is None or not self.frames:
            return []
        if len(self.frames) == OPTIONS.max_frames:
            # Frames are missing between the path and the fix.
            return []
        path = [self.first.pose, *(pose for _, pose in self.frames), by_odometry]
        corrected = corrected_path(path, self.first, fix)[1:-1]
        if largest_change_m(path[1:-1], corrected) <= OPTIONS.min_change_m:
            return []
        return [(point, pose) for (point, _), pose in zip(self.frames, corrected, strict=True)]


def moved_points(
    corrected: Sequence[tuple[SessionPoint, Pose]], floors: Sequence[Floor], *, has_plan: bool
) -> list[SessionPoint]:
    """Return points of a trajectory at their corrected poses, with floor and plan anew; `has_plan` says whether the
    map's axis of up and its scale are known."""
    found = []
    for point, pose in corrected:
        floor = floor_of(list(floors), pose)
        plan = None if floor is None or not has_plan else plan_point(floor, pose)
        found.append(
            replace(
                point,
                pose=pose_to_json(pose),
                floor=None if floor is None else floor.id,
                plan=None if plan is None else [plan.x, plan.y, plan.heading_deg],
            )
        )
    return found


def recent_points(
    recent: Sequence[SessionPoint], corrected: Sequence[SessionPoint], newest: SessionPoint, count: int
) -> list[SessionPoint]:
    """Return the last points of a trajectory, those that were corrected at their new places."""
    moved = {point.frame: point for point in corrected}
    return [*(moved.get(point.frame, point) for point in recent), newest][-count:]
