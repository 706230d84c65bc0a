"""A view of a session's own path: a frame with the places of what it shows, as odometry had them then, and what a later
frame that shows the same says of its pose. That pose is as good as the earlier one was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.query.accuracy import accuracy_of, sigma_across
from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.query.verification import coverage
from app.engine.tracking.fix import Fix, confidence_of_sigma
from app.engine.tracking.odometry.points import OPTIONS as POINT_OPTIONS
from app.engine.tracking.odometry.points import TrackedPoints
from app.engine.tracking.orb_matches import orb_features, orb_matches
from app.engine.tracking.state import TrackingMemory
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.pose_refinement import refine_pose
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]
BY_LOOPS = "roomfix track --no-map-after 1 --and-back 1 on desk_rs; docs/figures/track.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnViewOptions:
    """Which views of its own path a session keeps, and when one is recognised."""

    spacing_m: float = limit(
        0.5,
        "Path from one view that is kept to the next.",
        chosen="By hand: a view still shows much of the last.",
    )
    spacing_rad: float = limit(
        0.35, "Turn from one view that is kept to the next.", chosen="By hand: a third of the field of view."
    )
    most_views: int = limit(
        120, "Most views of a session.", chosen="By hand: 60 m of path, and 4 MB of memory."
    )
    look_every: int = limit(5, "Frames from one look for an earlier view to the next.", chosen=BY_LOOPS)
    same_spot_tangent: float = limit(
        tangent_of_px(4.0),
        "A feature within this radius of a followed point, over the focal length, is as far away as that.",
        chosen="By hand: corners are found by both within a few pixels.",
    )
    min_points: int = limit(
        40, "Fewest placed features of a view that is kept.", chosen="By hand: some more than min_inliers."
    )
    max_sigma_ratio: float = limit(
        0.7,
        "Position sigma of an earlier view over the present one above which coming back tells nothing new.",
        chosen="By hand: half of the variance.",
    )
    lost_views_tried: int = limit(
        6,
        "Earlier views that a frame is matched with which could not be followed.",
        chosen="By hand: for speed.",
    )
    lost_inlier_factor: float = limit(
        1.5,
        "Fewest inliers of such a frame, as a multiple of min_inliers.",
        chosen="By hand: nothing else says that it is near its last place.",
    )
    loop_ratio: float = limit(
        3.0,
        "Least way since a view, path or turn, over how far from it the camera is: less is no loop, and tells nothing.",
        chosen=BY_LOOPS,
    )
    loop_m: float = limit(1.0, "Least path of a loop.", chosen=BY_LOOPS)
    loop_rad: float = limit(0.7, "Least turn of a loop without such a path.", chosen=BY_LOOPS)
    max_depth_sigma: float = limit(
        0.06,
        "Largest relative sigma of the distance of a point that a view is kept with.",
        chosen="By hand: such a point is off by a pixel from half a metre aside.",
    )
    views_tried: int = limit(3, "Earlier views that one frame is matched with.", chosen="By hand: for speed.")
    reach_m: float = limit(
        2.0,
        "Distance of an earlier view's camera, beyond what odometry may be off, that is tried.",
        chosen=BY_LOOPS,
    )
    min_cosine: float = limit(
        0.82, "Least cosine between the axes of two views that show the same.", chosen="By hand: 35 degrees."
    )
    turn_m: float = limit(
        2.0,
        "Metres that a difference of 1 in that cosine counts for when views are ranked.",
        chosen="By hand.",
    )
    max_ratio: float = limit(0.8, "Largest ratio of the two least distances.", chosen="By hand: a usual one.")
    max_error_tangent: float = limit(
        tangent_of_px(4.0),
        "Inlier threshold: the reprojection error over the focal length.",
        chosen=BY_LOOPS,
    )
    min_inliers: int = limit(25, "Fewest inliers.", chosen="By hand: twice what chance finds.")
    min_inlier_ratio: float = limit(
        0.5, "Least ratio of inliers to matches.", chosen="By hand: as a step of odometry."
    )
    min_coverage: float = limit(
        0.12, "Least coverage of the inliers.", chosen="By hand: as a step of odometry."
    )


OPTIONS = OwnViewOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnView:
    """A view that was kept: what the session knew then, and its features (n, 32) with the places of what they show
    (n, 3), each uncertain along its ray by `sigma_m` (n,)."""

    memory: TrackingMemory
    pose: Pose
    accuracy: Accuracy
    descriptors: NDArray[np.uint8]
    points_in_frame: Array
    sigma_m: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenAgain:
    """An earlier view that a frame shows again: the frame's pose by it, how accurate that is besides what the view's
    own pose is off by, and the pixels (n, 2) and points (n, 3) that agree, these uncertain by `point_sigma_m` (n,)."""

    view: OwnView
    pose: Pose
    relative: Accuracy
    support: Support
    points_px: Array
    points_in_frame: Array
    point_sigma_m: Array

    @property
    def time_s(self) -> float:
        """When the earlier view was taken."""
        return self.view.memory.time_s

    @property
    def accuracy(self) -> Accuracy:
        """One sigma of the pose in the frame that it is placed in."""
        return Accuracy(
            float(np.hypot(self.relative.position_m, self.view.accuracy.position_m)),
            float(np.hypot(self.relative.orientation_deg, self.view.accuracy.orientation_deg)),
        )

    def as_fix(self, camera: Camera) -> Fix:
        """Return what odometry begins with anew: points that are uncertain along their rays."""
        return Fix(
            placed=PlacedPose(self.pose, self.view.memory.frame_id),
            accuracy=self.accuracy,
            support=self.support,
            confidence=confidence_of_sigma(self.accuracy),
            points_px=self.points_px,
            points_in_frame=self.points_in_frame,
            point_sigma_m=self.point_sigma_m,
            camera=camera,
            method="odometry",
            scale_sigma=OPTIONS.max_depth_sigma,
        )

    def memory_at(self, pose: Pose, now: TrackingMemory, time_s: float) -> TrackingMemory:
        """Return what a session remembers of a frame whose pose is given: the camera is where it was then, with the
        drift that it had then."""
        return replace(
            self.view.memory,
            state="tracking",
            last=PlacedPose(pose, self.view.memory.frame_id),
            time_s=time_s,
            lens=now.lens,
            pending=None,
        )


def view_of(
    gray: Gray, camera: Camera, memory: TrackingMemory, accuracy: Accuracy, points: TrackedPoints
) -> OwnView | None:
    """Return a frame as a view, None where too few of its features are placed."""
    pose = memory.frame_from_camera
    placed = points.take(
        points.from_fix | (points.inverse_sigma <= OPTIONS.max_depth_sigma * points.inverse_m)
    )
    pixels, descriptors = orb_features(gray)
    if pose is None or len(placed) < OPTIONS.min_points or len(pixels) < OPTIONS.min_points:
        return None
    apart_px, near = cKDTree(placed.pixels).query(pixels)
    rows = np.flatnonzero(apart_px <= OPTIONS.same_spot_tangent * camera.focal_px)
    if len(rows) < OPTIONS.min_points:
        return None
    same = placed.take(np.asarray(near, np.intp)[rows])
    distances_m = np.linalg.norm(same.points_in_frame - pose.translation, axis=1)
    rays = homogeneous(camera.normalize(pixels[rows])) @ pose.rotation.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return OwnView(
        memory=memory,
        pose=pose,
        accuracy=accuracy,
        descriptors=descriptors[rows],
        points_in_frame=pose.translation + rays * distances_m[:, None],
        sigma_m=np.hypot(same.inverse_sigma / same.inverse_m**2, same.across_m),
    )


def seen_again(
    view: OwnView, pixels: Array, descriptors: NDArray[np.uint8], camera: Camera, near: Pose | None
) -> SeenAgain | None:
    """Return what the features of a frame say of its pose by an earlier view, None unless enough of them agree."""
    rows, of_view = orb_matches(descriptors, view.descriptors, OPTIONS.max_ratio)
    if len(rows) < OPTIONS.min_inliers:
        return None
    points = view.points_in_frame[of_view]
    found = estimate_pose_lo_ransac(
        pixels[rows],
        points,
        camera,
        max_error_px=OPTIONS.max_error_tangent * camera.focal_px,
        max_iterations=300,
        min_iterations=20,
        prior=near,
    )
    if found is None:
        return None
    agree = found.inlier_mask
    count = int(np.count_nonzero(agree))
    if count < max(OPTIONS.min_inliers, OPTIONS.min_inlier_ratio * len(rows)):
        return None
    seen_px, seen_in_frame = pixels[rows][agree], points[agree]
    if coverage(seen_px, (camera.width, camera.height)) < OPTIONS.min_coverage:
        return None
    sigma_m = view.sigma_m[of_view][agree]
    pose = _refined(seen_px, seen_in_frame, sigma_m, camera, view.pose, found.world_from_camera)
    if pose is None:
        return None
    across_m = sigma_across(sigma_m, seen_in_frame, view.pose.translation, pose.translation)
    return SeenAgain(
        view=view,
        pose=pose,
        relative=accuracy_of(seen_px, seen_in_frame, across_m, camera, pose),
        support=Support(count, len(rows)),
        points_px=seen_px,
        points_in_frame=seen_in_frame,
        point_sigma_m=across_m,
    )


def _refined(
    pixels: Array, points: Array, sigma_m: Array, camera: Camera, before: Pose, pose: Pose
) -> Pose | None:
    """Return a pose refined on pixels (n, 2) and points (n, 3), each as far as its place is known from aside; `before`
    is the pose that placed them, uncertain along their rays by `sigma_m` (n,). None where they don't determine it."""
    across_m = sigma_across(sigma_m, points, before.translation, pose.translation)
    distances_m = np.maximum(np.linalg.norm(points - pose.translation, axis=1), 1e-6)
    weights = 1.0 / (1.0 + (across_m / distances_m / POINT_OPTIONS.flow_sigma_tangent) ** 2)
    try:
        return refine_pose(pixels, points, camera, pose, weights=weights, max_steps=6)
    except DegenerateGeometryError:
        return None
