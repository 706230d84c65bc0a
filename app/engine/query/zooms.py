"""Which zoom the matches of a query agree with, where most of them contradict the camera that was stated for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.query.hypothesis import Hypothesis
from app.engine.query.matches import Matches
from app.geometry.camera import Camera
from app.geometry.intrinsics_check import zoomed_cameras
from app.geometry.pnp import PnpEstimate
from app.geometry.reprojection import reprojection_errors_of_views, reprojection_errors_px
from app.geometry.se3 import Pose
from app.limits import limit

# Zooms that are tried where few of the matches agree: steps that leave less than 13 % between them. The last one is
# beyond what refining may find, so that such a picture is refused.
ZOOMS = (0.57, 0.71, 0.89, 1.12, 1.4, 1.75, 2.2, 2.75)
# Returns the pose by each of several cameras that most matches agree on, by so many samples, None where too few agree.
PosesByCamera = Callable[[Matches, Sequence[Camera], int], list[PnpEstimate | None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoomOptions:
    """When other zooms are tried, and when one is preferred."""

    screen_iterations: int = limit(
        150,
        "Samples of RANSAC for each zoom that is tried.",
        chosen="By hand: four right matches of ten are drawn together in a few dozen samples.",
    )
    screen_matches: int = limit(300, "Most matches that zooms are tried with.", chosen="By hand: for speed.")
    screen_ratio: float = limit(
        1.15,
        "Inliers with a zoom, over those without, from which on refining starts there.",
        chosen="By hand: between no gain and that of a zoom that is 12 % off.",
    )
    min_features: int = limit(
        12, "Fewest features that agree with a zoom.", chosen="By hand: as many as a camera is checked with."
    )


OPTIONS = ZoomOptions()


@dataclass(frozen=True, slots=True)
class Zoom:
    """A camera of another zoom that more matches agree with by as few samples, and whether as many do as with the pose
    by the stated camera, which took more samples."""

    camera: Camera
    rivals_pose: bool


def most_agreeing_zoom(best: Hypothesis, camera: Camera, poses: PosesByCamera) -> Zoom | None:
    """Return the zoom that most matches agree with, None where that is about the stated camera.

    A wrong focal length can leave a few inliers of one part of the picture that show nothing of it; that most matches
    are no inliers does.
    """
    count = len(best.estimate.inlier_mask)
    some = best.matches.take(np.arange(0, count, -(-count // OPTIONS.screen_matches)))
    zoomed, limit_px = zoomed_cameras(camera, ZOOMS), limit_px_of(best, camera)
    cameras = [*zoomed, camera]
    found = poses(some, cameras, OPTIONS.screen_iterations)
    views = [
        (each, None if pose is None else pose.world_from_camera)
        for each, pose in zip(cameras, found, strict=True)
    ]
    errors = reprojection_errors_of_views(some.points_px, some.points_in_world, [*views, (camera, best.pose)])
    *counts, stated, by_pose = some.feature_counts([errors_px <= limit_px for errors_px in errors])
    most = int(np.argmax(counts))
    if counts[most] < OPTIONS.min_features or counts[most] < OPTIONS.screen_ratio * stated:
        return None
    return Zoom(zoomed[most], rivals_pose=bool(counts[most] >= by_pose))


def limit_px_of(best: Hypothesis, camera: Camera) -> float:
    """Return about the reprojection error up to which matches agree with the stated camera."""
    inliers = best.inliers
    return float(
        np.max(reprojection_errors_px(inliers.points_px, inliers.points_in_world, camera, best.pose))
    )


def agreement(matches: Matches, camera: Camera, pose: Pose, limit_px: float) -> tuple[int, float]:
    """Return how many features agree with a camera and its pose, and the cost of all matches: the sum of the squared
    errors over their limit, each at most 1 (MSAC).

    The limit is one in pixels for all cameras: an angle would let more matches agree with each longer focal length.
    """
    errors_px = reprojection_errors_px(matches.points_px, matches.points_in_world, camera, pose)
    (agreeing,) = matches.feature_counts([errors_px <= limit_px])
    return agreeing, float(np.minimum((errors_px / limit_px) ** 2, 1.0).sum())
