"""The last keyframes of odometry, adjusted together whenever one is added."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.geometry.bundle import Bundle, adjust_bundle, lens_in_bundle
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.se3 import Pose

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

# Views that are adjusted together, and how many of the oldest keep their poses: they hold place and scale.
WINDOW, HELD = 24, 2
# A point that was seen less often says nothing that the pose doesn't need to explain it.
MIN_VIEWS = 2
# Fewer leave poses undetermined.
MIN_POINTS = 20
# What windows say of the lens is off by about so much: they overlap, and hold the poses of their oldest views. A
# window's step is not believed beyond this, and the lens never taken to be known better than that.
WINDOW_LENS_SIGMA, MAX_LENS_STEP, LEAST_LENS_SIGMA = 0.01, 0.03, 0.005


@dataclass(frozen=True, slots=True)
class KeyView:
    """A keyframe of odometry: its pose, and the pixels (n, 2) of points by their ids (n,)."""

    world_from_camera: Pose
    ids: Ids
    pixels: Array


@dataclass(slots=True)
class Window:
    """The last keyframes, and the points that they see: `ids` (n,), places in the world (n, 3), and where a fix has
    each (n, 3), to within so many metres (n,), infinite for points of odometry's own."""

    views: list[KeyView] = field(default_factory=list)
    ids: Ids = field(default_factory=lambda: np.zeros(0, np.int64))
    points_in_world: Array = field(default_factory=lambda: np.zeros((0, 3)))
    prior: Array = field(default_factory=lambda: np.zeros((0, 3)))
    prior_sigma_m: Array = field(default_factory=lambda: np.zeros(0))

    def add(self, view: KeyView, points_in_world: Array, prior: Array, prior_sigma_m: Array) -> None:
        """Add a keyframe, where its points are (n, 3), and where fixes have them (n, 3), (n,); the oldest one goes,
        with what only it saw."""
        self.views = [*self.views, view][-WINDOW:]
        old = ~np.isin(self.ids, view.ids) & np.isin(self.ids, np.concatenate([v.ids for v in self.views]))
        ids = np.concatenate([self.ids[old], view.ids])
        order = np.argsort(ids)
        self.ids = ids[order]
        self.points_in_world = np.concatenate([self.points_in_world[old], points_in_world])[order]
        self.prior = np.concatenate([self.prior[old], prior])[order]
        self.prior_sigma_m = np.concatenate([self.prior_sigma_m[old], prior_sigma_m])[order]

    def move(self, new_from_old: Pose) -> None:
        """Move views and points by a correction of the frame that they are in; what fixes said of points is void."""
        self.views = [
            KeyView(new_from_old @ view.world_from_camera, view.ids, view.pixels) for view in self.views
        ]
        self.points_in_world = new_from_old.apply(self.points_in_world)
        self.prior = self.points_in_world.copy()
        self.prior_sigma_m = np.full(len(self.ids), np.inf)

    def rescale(self, centre: Array, factor: float, new_from_old: Pose) -> None:
        """Make all that is between the views, the points and a centre (3,) so many times as long, then move it; what
        fixes said of points is moved with it."""

        def moved(points: Array) -> Array:
            return new_from_old.apply(centre + factor * (points - centre))

        self.views = [
            KeyView(
                Pose(
                    new_from_old.rotation @ view.world_from_camera.rotation,
                    moved(view.world_from_camera.translation[None])[0],
                ),
                view.ids,
                view.pixels,
            )
            for view in self.views
        ]
        self.points_in_world, self.prior = moved(self.points_in_world), moved(self.prior)
        self.prior_sigma_m = self.prior_sigma_m * factor

    def adjust(self, camera: Camera, lens: Lens | None) -> tuple[Ids, Lens | None]:
        """Adjust the views and the points that enough of them see; return the ids of these, and of a lens that is not
        stated what is known now. `camera` is behind it."""
        seen = np.concatenate([view.ids for view in self.views])
        unique, counts = np.unique(seen, return_counts=True)
        used = unique[counts >= MIN_VIEWS]
        if len(self.views) <= HELD or len(used) < MIN_POINTS:
            return np.zeros(0, np.int64), lens
        chosen, keep = np.searchsorted(self.ids, used), np.isin(seen, used)
        views = np.repeat(np.arange(len(self.views)), [len(view.ids) for view in self.views])[keep]
        bundle = Bundle(
            camera,
            views.astype(np.intp),
            np.searchsorted(used, seen[keep]).astype(np.intp),
            np.concatenate([view.pixels for view in self.views])[keep],
            np.arange(len(self.views)) < HELD,
            self.prior[chosen],
            self.prior_sigma_m[chosen],
        )
        poses = [view.world_from_camera for view in self.views]
        adjusted, self.points_in_world[chosen] = adjust_bundle(bundle, poses, self.points_in_world[chosen])
        # What leaves the view is held where it is now.
        self.prior[chosen] = self.points_in_world[chosen]
        self.views = [
            KeyView(pose, view.ids, view.pixels) for pose, view in zip(adjusted, self.views, strict=True)
        ]
        if lens is not None:
            lens = _learned(lens, *lens_in_bundle(bundle, adjusted, self.points_in_world[chosen]))
        return used, lens


def _learned(lens: Lens, step: float, information: float) -> Lens:
    """Return a lens with what a window says: it would have the coefficient larger by a step."""
    variance = 1.0 / max(information, 1e-9) + WINDOW_LENS_SIGMA**2
    gain = lens.sigma**2 / (lens.sigma**2 + variance)
    step = float(np.clip(step, -MAX_LENS_STEP, MAX_LENS_STEP))
    return Lens(
        lens.coefficient + gain * step, max(lens.sigma * float(np.sqrt(1.0 - gain)), LEAST_LENS_SIGMA)
    )
