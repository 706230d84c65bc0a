"""What a monitoring camera sees of the points that odometry follows: one more view of them, and the scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.lens import has_focal_of
from app.geometry.se3 import Pose

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

# By pixels (n, 2) of a monitoring camera, and how far from it what they show comes out (n,): the logarithm that all
# lengths are too short by, and one sigma of it; None where nothing with a known distance is among them.
ScaleOf = Callable[[Array, Array], tuple[float, float] | None]


@dataclass(frozen=True, slots=True)
class SeenByMonitor:
    """Where a monitoring camera, at a pose in the frame of the fix, sees a fix's points (n, 2), and what it knows of
    their scale, None where that is the fix's own."""

    camera: Camera
    frame_from_camera: Pose
    points_px: Array
    scale_of: ScaleOf | None = None


@dataclass(frozen=True, slots=True)
class MonitorView:
    """A monitoring camera's pose in odometry's frame, and its pixels (n, 2) of points by their ids (n,), ascending."""

    seen: SeenByMonitor
    ids: Ids

    @staticmethod
    def of(seen: SeenByMonitor, ids: Ids, rows: NDArray[np.intp]) -> MonitorView:
        """Return the view of those points of a fix that are followed as `ids` (n,), each once."""
        order = np.argsort(ids)
        return MonitorView(replace(seen, points_px=seen.points_px[rows[order]]), ids[order])

    def with_more(self, other: MonitorView) -> MonitorView:
        """Return this view with what a later look saw of points that this one doesn't have."""
        fresh = ~np.isin(other.ids, self.ids)
        ids = np.concatenate([self.ids, other.ids[fresh]])
        pixels = np.concatenate([self.seen.points_px, other.seen.points_px[fresh]])
        order = np.argsort(ids)
        return MonitorView(replace(self.seen, points_px=pixels[order]), ids[order])

    def at(self, frame_from_camera: Pose) -> MonitorView:
        """Return this view from another pose, as the frame that it is in is changed."""
        return replace(self, seen=replace(self.seen, frame_from_camera=frame_from_camera))

    def has_lens_of(self, camera: Camera) -> bool:
        """Whether a phone's camera with this focal length is of the same make: then its lens is this one's."""
        return self.seen.camera.model == "PINHOLE" and has_focal_of(self.seen.camera, camera)

    def pixels_in(self, camera: Camera) -> Array:
        """Return where a phone's camera would see the points (n, 2) from here."""
        own, pixels = self.seen.camera, self.seen.points_px
        if self.has_lens_of(camera):
            return np.asarray((pixels + 0.5) * (camera.width / own.width) - 0.5)
        return camera.project(own.unproject(pixels, np.ones(len(pixels))))

    def scale(self, ids: Ids, points_in_frame: Array) -> tuple[float, float] | None:
        """Return by which logarithm lengths are too short, and one sigma of it, where points with ids (n,), ascending,
        are at (n, 3); None where that isn't known."""
        if self.seen.scale_of is None:
            return None
        _, ours, theirs = np.intersect1d(self.ids, ids, return_indices=True)
        away = np.linalg.norm(points_in_frame[theirs] - self.seen.frame_from_camera.translation, axis=1)
        return self.seen.scale_of(self.seen.points_px[ours], away)
