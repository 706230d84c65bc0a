"""The last keyframes of odometry, adjusted together whenever one is added."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.engine.tracking.odometry.monitor_view import MonitorView
from app.geometry.bundle import Bundle, adjust_bundle, lens_in_bundle
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowOptions:
    """Which keyframes are adjusted together."""

    keyframes: int = limit(
        24,
        "Keyframes that are adjusted together.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    held_keyframes: int = limit(
        2,
        "Oldest keyframes whose poses are kept: they hold place and scale.",
        chosen="By hand: the least that fixes a scale.",
    )
    min_shared_points: int = limit(
        15,
        "Points shared with a monitoring camera from which on its pose alone is kept.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    min_views: int = limit(
        2, "Views that a point needs to take part.", chosen="By hand: with one view it says nothing."
    )
    min_points: int = limit(
        20, "Fewest points of an adjustment.", chosen="roomfix track and track-anchors; docs/sessions.md."
    )
    max_lens_step: float = limit(
        0.03,
        "Largest change of the lens coefficient in one adjustment.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    least_lens_sigma: float = limit(
        0.005,
        "Least standard deviation of the lens coefficient.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )


OPTIONS = WindowOptions()


@dataclass(frozen=True, slots=True)
class KeyView:
    """A keyframe of odometry: its pose, and the pixels (n, 2) of points by their ids (n,)."""

    frame_from_camera: Pose
    ids: Ids
    pixels: Array


@dataclass(slots=True, kw_only=True)
class Window:
    """The last keyframes, and the points that they see: `ids` (n,), places in the world (n, 3), and where a fix has
    each (n, 3), to within so many metres (n,), infinite for points of odometry's own. `monitor` is what a monitoring
    camera sees of them, `lens_before` what was known of the lens before it did."""

    views: list[KeyView] = field(default_factory=list)
    ids: Ids = field(default_factory=lambda: np.zeros(0, np.int64))
    points_in_frame: Array = field(default_factory=lambda: np.zeros((0, 3)))
    prior: Array = field(default_factory=lambda: np.zeros((0, 3)))
    prior_sigma_m: Array = field(default_factory=lambda: np.zeros(0))
    monitor: MonitorView | None = None
    lens_before: Lens | None = None

    def add(self, view: KeyView, points_in_frame: Array, prior: Array, prior_sigma_m: Array) -> None:
        """Add a keyframe, where its points are (n, 3), and where fixes have them (n, 3), (n,); the oldest one goes,
        with what only it saw."""
        self.views = [*self.views, view][-OPTIONS.keyframes :]
        old = ~np.isin(self.ids, view.ids) & np.isin(self.ids, np.concatenate([v.ids for v in self.views]))
        ids = np.concatenate([self.ids[old], view.ids])
        order = np.argsort(ids)
        self.ids = ids[order]
        self.points_in_frame = np.concatenate([self.points_in_frame[old], points_in_frame])[order]
        self.prior = np.concatenate([self.prior[old], prior])[order]
        self.prior_sigma_m = np.concatenate([self.prior_sigma_m[old], prior_sigma_m])[order]

    def move(self, new_from_old: Pose) -> None:
        """Move views and points by a correction of the frame that they are in; what fixes said of points is void."""
        self.views = [
            KeyView(new_from_old @ view.frame_from_camera, view.ids, view.pixels) for view in self.views
        ]
        self.points_in_frame = new_from_old.apply(self.points_in_frame)
        self.monitor = None
        self.prior = self.points_in_frame.copy()
        self.prior_sigma_m = np.full(len(self.ids), np.inf)

    def rescale(self, centre: Array, factor: float, new_from_old: Pose) -> None:
        """Make all that is between the views, the points and a centre (3,) so many times as long, then move it; what
        fixes said of points is moved with it."""

        def moved(points: Array) -> Array:
            return new_from_old.apply(centre + factor * (points - centre))

        def moved_pose(pose: Pose) -> Pose:
            return Pose(new_from_old.rotation @ pose.rotation, moved(pose.translation[None])[0])

        self.views = [
            KeyView(moved_pose(view.frame_from_camera), view.ids, view.pixels) for view in self.views
        ]
        if self.monitor is not None:
            self.monitor = self.monitor.at(moved_pose(self.monitor.seen.frame_from_camera))
        self.points_in_frame, self.prior = moved(self.points_in_frame), moved(self.prior)
        self.prior_sigma_m = self.prior_sigma_m * factor

    def adjust(self, camera: Camera, lens: Lens | None) -> tuple[Ids, Lens | None]:
        """Adjust the views and the points that enough of them see; return the ids of these, and of a lens that is not
        stated what is known now. `camera` is behind it."""
        monitor = self._monitor_in(camera)
        all_views = [*monitor, *self.views]
        held = len(monitor) or OPTIONS.held_keyframes
        seen = np.concatenate([view.ids for view in all_views])
        unique, counts = np.unique(seen, return_counts=True)
        used = unique[counts >= OPTIONS.min_views]
        if len(all_views) <= OPTIONS.held_keyframes or len(used) < OPTIONS.min_points:
            return np.zeros(0, np.int64), lens
        chosen, keep = np.searchsorted(self.ids, used), np.isin(seen, used)
        views = np.repeat(np.arange(len(all_views)), [len(view.ids) for view in all_views])[keep]
        bundle = Bundle(
            camera=camera,
            views=views.astype(np.intp),
            rows=np.searchsorted(used, seen[keep]).astype(np.intp),
            pixels=np.concatenate([view.pixels for view in all_views])[keep],
            is_fixed=np.arange(len(all_views)) < held,
            prior=self.prior[chosen],
            prior_sigma_m=self.prior_sigma_m[chosen],
            has_lens=self._has_lens(camera, len(all_views)),
        )
        poses = [view.frame_from_camera for view in all_views]
        adjusted, self.points_in_frame[chosen] = adjust_bundle(bundle, poses, self.points_in_frame[chosen])
        # What leaves the view is held where it is now.
        self.prior[chosen] = self.points_in_frame[chosen]
        self.views = [
            KeyView(pose, view.ids, view.pixels)
            for pose, view in zip(adjusted[len(monitor) :], self.views, strict=True)
        ]
        if lens is not None and monitor:
            said = lens_in_bundle(bundle, adjusted, self.points_in_frame[chosen])
            lens = self._learned(lens, *said)
        return used, lens

    def _learned(self, lens: Lens, step: float, information: float) -> Lens:
        """Return a lens by what was known of it before a monitoring camera's view was there, and what all views say
        now: they say it anew each time, as none of the phone's own poses is held."""
        before = self.lens_before = self.lens_before or lens
        variance = 1.0 / max(information, 1e-9) + OPTIONS.least_lens_sigma**2
        gain = before.sigma**2 / (before.sigma**2 + variance)
        found = lens.coefficient + float(np.clip(step, -OPTIONS.max_lens_step, OPTIONS.max_lens_step))
        return Lens(
            before.coefficient + gain * (found - before.coefficient),
            max(before.sigma * float(np.sqrt(1.0 - gain)), OPTIONS.least_lens_sigma),
        )

    def _monitor_in(self, camera: Camera) -> list[KeyView]:
        """Return the monitoring camera's view of points in the window as this camera's, or none where they are few."""
        if self.monitor is None:
            return []
        known = np.isin(self.monitor.ids, self.ids)
        if np.count_nonzero(known) < OPTIONS.min_shared_points:
            return []
        pixels = self.monitor.pixels_in(camera)[known]
        return [KeyView(self.monitor.seen.frame_from_camera, self.monitor.ids[known], pixels)]

    def _has_lens(self, camera: Camera, count: int) -> NDArray[np.bool_]:
        """Return which of so many views (n,), a monitoring camera's first, are through this camera's lens."""
        others = count - len(self.views)
        is_alike = self.monitor is not None and self.monitor.has_lens_of(camera)
        return np.array([is_alike] * others + [True] * len(self.views))

    def scale(self) -> tuple[float, float] | None:
        """Return by which logarithm all lengths are too short, and one sigma of it, by what a monitoring camera knows;
        None where that is nothing."""
        if (
            self.monitor is None
            or np.count_nonzero(np.isin(self.monitor.ids, self.ids)) < OPTIONS.min_shared_points
        ):
            return None
        return self.monitor.scale(self.ids, self.points_in_frame)
