"""A fix by one other view whose pose is known: what an anchor gives, ready for odometry to go on from.

The relative pose is up to scale (C 4.2.4); a known distance makes it metric (C 4.2.7). The points that both views
see are triangulated with it, so that odometry starts with the anchor's own scale and needs no second one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.query.accuracy import accuracy_of
from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.query.verification import coverage
from app.engine.tracking.fix import Fix, confidence_of_sigma
from app.engine.tracking.odometry.monitor_view import ScaleOf, SeenByMonitor
from app.geometry.camera import Camera
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose, rotation_from_vector, vector_from_rotation
from app.geometry.triangulation import triangulate
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoViewOptions:
    """When a fix by two views is one."""

    min_points: int = limit(
        20, "Fewest triangulated points.", chosen="roomfix track-anchors; docs/anchors.md."
    )
    min_coverage: float = limit(
        0.1, "Least coverage of the triangulated points.", chosen="roomfix track-anchors; docs/anchors.md."
    )
    max_error_px: float = limit(
        3.0,
        "Largest reprojection error of a triangulated point in either view.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    min_parallax_deg: float = limit(
        1.0,
        "Least angle between two rays that place a point.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    match_sigma_px: float = limit(
        1.0, "Standard deviation of a matched pixel.", chosen="By hand: the accuracy of a keypoint."
    )
    min_scale_sigma: float = limit(
        0.01,
        "Least relative sigma of a single fix's scale, besides what it shares with others.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )
    contradiction_sigmas: float = limit(
        3.0,
        "Scales that differ by more sigmas are not of the same place.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )


OPTIONS = TwoViewOptions()


@dataclass(frozen=True, slots=True)
class KnownView:
    """The other view: its camera, where it is placed, and what it knows of distances.

    `scale_sigma` is the relative standard deviation of the relative pose's scale, `shared_scale_sigma` the part of it
    that is the same whatever is seen in the view.
    """

    camera: Camera
    placed: PlacedPose
    scale_sigma: float = 0.0
    shared_scale_sigma: float = 0.0
    scale_of: ScaleOf | None = None


@dataclass(frozen=True, slots=True)
class TrackedPlace:
    """Where odometry has a camera since an earlier fix, one sigma of it, and of its scale."""

    placed: PlacedPose
    accuracy: Accuracy
    scale_sigma: float


def fix_from_two_views(
    points_px: Array, points_in_known_px: Array, camera: Camera, known: KnownView, known_from_camera: Pose
) -> Fix | None:
    """Return the fix of a camera whose metric pose in a known view is given, or None when too few of the matched
    pixels (n, 2), (n, 2) can be triangulated or they are all in one spot.

    `camera` is the one of the frame at tracking size, and so are `points_px`. The accuracy holds what the pixels
    leave open and what the scale is off by; all points share the latter, so it is not in their own sigma.
    """
    pose = known.placed.frame_from_camera @ known_from_camera
    points = triangulate(
        points_in_known_px,
        points_px,
        known.camera,
        camera,
        known_from_camera.inverse(),
        min_parallax_deg=OPTIONS.min_parallax_deg,
    )
    placed = np.isfinite(points).all(axis=1)
    in_frame = known.placed.frame_from_camera.apply(points)
    good = np.zeros(len(points), dtype=bool)
    good[placed] = (
        reprojection_errors_px(points_px[placed], in_frame[placed], camera, pose) < OPTIONS.max_error_px
    ) & (
        reprojection_errors_px(
            points_in_known_px[placed], in_frame[placed], known.camera, known.placed.frame_from_camera
        )
        < OPTIONS.max_error_px
    )
    if (
        good.sum() < OPTIONS.min_points
        or coverage(points_px[good], (camera.width, camera.height)) < OPTIONS.min_coverage
    ):
        return None
    sigma_m = _sigma_across(in_frame[good], camera, pose)
    own = accuracy_of(points_px[good], in_frame[good], sigma_m, camera, pose)
    baseline_m = float(np.linalg.norm(known_from_camera.translation))
    accuracy = replace(own, position_m=float(np.hypot(own.position_m, known.scale_sigma * baseline_m)))
    return Fix(
        placed=PlacedPose(pose, known.placed.frame_id),
        accuracy=accuracy,
        support=Support(int(good.sum()), len(points_px)),
        confidence=confidence_of_sigma(accuracy),
        points_px=points_px[good],
        points_in_frame=in_frame[good],
        point_sigma_m=sigma_m,
        camera=camera,
        method="anchor",
        scale_sigma=known.scale_sigma,
        shared_scale_sigma=known.shared_scale_sigma,
        seen=SeenByMonitor(
            known.camera, known.placed.frame_from_camera, points_in_known_px[good], known.scale_of
        ),
    )


def at_common_scale(fix: Fix, tracked: TrackedPlace, ratio: float) -> tuple[Fix, float] | None:
    """Return a fix by what it and odometry have in common, each by its certainty, and how many times as long
    odometry's lengths are to be; None when their scales contradict each other.

    `ratio` is how many times as far odometry, at the scale of earlier fixes, has what both see. What is seen tells it
    better than how far the phone is from the known view, which turns with every error of the relative pose. What
    fixes by one anchor are off by alike stays, however many there are.
    """
    shared = fix.shared_scale_sigma
    ours, theirs = _own_variance(fix.scale_sigma, shared), _own_variance(tracked.scale_sigma, shared)
    apart = float(np.log(ratio))
    if abs(apart) > OPTIONS.contradiction_sigmas * float(np.hypot(fix.scale_sigma, tracked.scale_sigma)):
        return None
    factor = float(np.exp(-apart * theirs / (ours + theirs)))
    sigma = float(np.hypot(shared, np.sqrt(ours * theirs / (ours + theirs))))
    place, turn = (
        _weight(tracked.accuracy.position_m, fix.accuracy.position_m),
        _weight(tracked.accuracy.orientation_deg, fix.accuracy.orientation_deg),
    )
    before, pose = tracked.placed.frame_from_camera, fix.frame_from_camera
    rotation = before.rotation @ rotation_from_vector(
        turn * vector_from_rotation(before.rotation.T @ pose.rotation)
    )
    common = Pose(rotation, before.translation + place * (pose.translation - before.translation))
    accuracy = Accuracy(
        min(tracked.accuracy.position_m, fix.accuracy.position_m),
        min(tracked.accuracy.orientation_deg, fix.accuracy.orientation_deg),
    )
    placed = replace(fix.placed, frame_from_camera=common)
    return replace(fix, placed=placed, accuracy=accuracy, scale_sigma=sigma), factor


def _weight(ours: float, theirs: float) -> float:
    """Return the say of theirs in the mean of two values with these sigmas."""
    return ours**2 / max(ours**2 + theirs**2, 1e-12)


def _own_variance(scale_sigma: float, shared: float) -> float:
    return max(scale_sigma**2 - shared**2, OPTIONS.min_scale_sigma**2)


def metric_relative_pose(b_from_a: Pose, scale: float) -> Pose:
    """Return a relative pose in metres, of one up to `scale` metres per unit (C eq. 4.2.7)."""
    return Pose(b_from_a.rotation, scale * b_from_a.translation)


def _sigma_across(points_in_frame: Array, camera: Camera, pose: Pose) -> Array:
    """Return how uncertain points are across the camera's ray, by the pixel they were matched with."""
    return np.asarray(
        OPTIONS.match_sigma_px / camera.focal_px * np.linalg.norm(points_in_frame - pose.translation, axis=1)
    )
