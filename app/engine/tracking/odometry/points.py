"""The points that odometry follows: pixels now, and places in the world that get better as the camera moves."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera, tangent_of_px
from app.geometry.reprojection import reprojection_jacobian
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class PointOptions:
    """How uncertain a followed point is."""

    flow_sigma_tangent: float = limit(
        tangent_of_px(1.5),
        "Standard deviation of optical flow over the focal length; above its noise, since its errors "
        "persist from frame to frame.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    new_depth_sigma: float = limit(
        0.75,
        "Relative sigma of a new point's distance, taken from its neighbours.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    min_distance_m: float = limit(
        0.15, "Nothing nearer to the camera is placed.", chosen="By hand: nearer than a phone focuses."
    )
    max_distance_m: float = limit(
        60.0, "Nothing farther from the camera is placed.", chosen="By hand: the length of a hall."
    )
    least_depth_sigma: float = limit(
        0.005,
        "Least relative sigma of a distance, however often a point was seen: the poses have errors too.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )


OPTIONS = PointOptions()


@dataclass(slots=True, kw_only=True)
class TrackedPoints:
    """Points being followed.

    `pixels` (n, 2) in the last frame. A point lies on the ray (n, 3) from `origin` (n, 3) at `inverse_m` (n,), one
    over its distance, which is uncertain by `inverse_sigma` (n,). `from_fix` (n,) marks points that a fix gave:
    their places are not changed, and `across_m` (n,) is their uncertainty in any direction. `ids` (n,) are given
    by whoever follows them.
    """

    ids: NDArray[np.int64]
    pixels: Array
    origin: Array
    ray: Array
    inverse_m: Array
    inverse_sigma: Array
    across_m: Array
    from_fix: Mask

    @staticmethod
    def none() -> TrackedPoints:
        """Return no points."""
        zero, line = np.zeros((0, 3)), np.zeros(0)
        return TrackedPoints(
            ids=np.zeros(0, np.int64),
            pixels=np.zeros((0, 2)),
            origin=zero,
            ray=zero,
            inverse_m=line,
            inverse_sigma=line,
            across_m=line,
            from_fix=np.zeros(0, dtype=bool),
        )

    @staticmethod
    def new(
        ids: NDArray[np.int64],
        pixels: Array,
        camera: Camera,
        frame_from_camera: Pose,
        distances_m: Array | float,
        share: float = OPTIONS.new_depth_sigma,
    ) -> TrackedPoints:
        """Return points (n, 2) seen for the first time, as far away as told, each (n,) or all, give or take that share
        of it: by default as things around them."""
        rays = homogeneous(camera.normalize(pixels)) @ frame_from_camera.rotation.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        n = len(pixels)
        return TrackedPoints(
            ids=ids,
            pixels=pixels,
            origin=np.tile(frame_from_camera.translation, (n, 1)),
            ray=rays,
            inverse_m=np.full(n, 1.0 / distances_m),
            inverse_sigma=np.full(n, share / distances_m),
            across_m=np.zeros(n),
            from_fix=np.zeros(n, dtype=bool),
        )

    @staticmethod
    def fixed(
        ids: NDArray[np.int64],
        pixels: Array,
        points_in_frame: Array,
        across_m: Array,
        frame_from_camera: Pose,
    ) -> TrackedPoints:
        """Return the points (n, 2), (n, 3) that a fix gave."""
        rays = points_in_frame - frame_from_camera.translation
        distances = np.maximum(np.linalg.norm(rays, axis=1), 1e-6)
        n = len(pixels)
        return TrackedPoints(
            ids=ids,
            pixels=pixels,
            origin=np.tile(frame_from_camera.translation, (n, 1)),
            ray=rays / distances[:, None],
            inverse_m=1.0 / distances,
            inverse_sigma=np.zeros(n),
            across_m=across_m,
            from_fix=np.ones(n, dtype=bool),
        )

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def points_in_frame(self) -> Array:
        """Where the points are (n, 3)."""
        return np.asarray(self.origin + self.ray / self.inverse_m[:, None])

    @property
    def is_placed(self) -> Mask:
        """Which points (n,) are placed well enough to find a pose from nothing."""
        return np.asarray(self.from_fix | (self.inverse_sigma < 0.2 * self.inverse_m))

    def take(self, rows: Mask | NDArray[np.intp]) -> TrackedPoints:
        """Return the points of the given rows."""
        return TrackedPoints(**{name: getattr(self, name)[rows] for name in FIELDS})

    def joined(self, other: TrackedPoints) -> TrackedPoints:
        """Return these points and the others."""
        return TrackedPoints(
            **{name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in FIELDS}
        )

    def moved(self, new_from_old: Pose) -> TrackedPoints:
        """Return the points with their places moved by a correction of the frame that they are in."""
        return TrackedPoints(
            ids=self.ids,
            pixels=self.pixels,
            origin=new_from_old.apply(self.origin),
            ray=self.ray @ new_from_old.rotation.T,
            inverse_m=self.inverse_m,
            inverse_sigma=self.inverse_sigma,
            across_m=self.across_m,
            from_fix=self.from_fix,
        )

    def scaled(self, centre: Array, factor: float) -> TrackedPoints:
        """Return the points with all that is between them and a centre (3,) so many times as long."""
        return replace(
            self,
            origin=centre + factor * (self.origin - centre),
            inverse_m=self.inverse_m / factor,
            inverse_sigma=self.inverse_sigma / factor,
            across_m=self.across_m * factor,
        )

    def place(self, rows: NDArray[np.intp], points_in_frame: Array) -> None:
        """Put points (n,) where a bundle adjustment has them (n, 3)."""
        rays = points_in_frame - self.origin[rows]
        distances = np.clip(np.linalg.norm(rays, axis=1), OPTIONS.min_distance_m, OPTIONS.max_distance_m)
        self.ray[rows], self.inverse_m[rows] = rays / distances[:, None], 1.0 / distances

    def sigma_across_m(self, centre: Array) -> Array:
        """Return how uncertain the points are (n,) across the rays from a centre (3,).

        A point is uncertain along its first ray: seen from where it was seen first, that doesn't show.
        """
        seen = self.points_in_frame - centre
        sines = np.linalg.norm(np.cross(self.ray, seen), axis=1) / np.maximum(
            np.linalg.norm(seen, axis=1), 1e-9
        )
        return np.asarray(np.hypot(self.inverse_sigma / self.inverse_m**2 * sines, self.across_m))

    def observe(self, camera: Camera, frame_from_camera: Pose) -> None:
        """Better the distances of the points by where they are seen now, a Kalman filter for each of them.

        The state is the inverse distance on the first ray, whose effect on the pixel is nearly linear.
        """
        rows = np.flatnonzero(~self.from_fix)
        points = self.points_in_frame[rows]
        projected, _, by_point = reprojection_jacobian(points, camera, frame_from_camera)
        inverse = self.inverse_m[rows]
        slope = np.einsum("nij,nj->ni", by_point, -self.ray[rows] / inverse[:, None] ** 2)
        offset = self.pixels[rows] - projected
        usable = np.isfinite(slope).all(axis=1) & np.isfinite(offset).all(axis=1)
        rows, slope, offset = rows[usable], slope[usable], offset[usable]
        noise = (OPTIONS.flow_sigma_tangent * camera.focal_px) ** 2
        information = 1.0 / self.inverse_sigma[rows] ** 2 + np.sum(slope**2, axis=1) / noise
        step = np.sum(slope * offset, axis=1) / noise / information
        moved = np.clip(
            self.inverse_m[rows] + step, 1.0 / OPTIONS.max_distance_m, 1.0 / OPTIONS.min_distance_m
        )
        self.inverse_m[rows] = moved
        self.inverse_sigma[rows] = np.maximum(1.0 / np.sqrt(information), OPTIONS.least_depth_sigma * moved)


FIELDS = tuple(each.name for each in fields(TrackedPoints))
