"""The motion between two frames that see the same place, measured from their features and depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.alignment import average_poses
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.limits import limit
from app.vision.features import LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """When two frames see the same place."""

    ratio: float = limit(
        0.8,
        "Largest distance of the best match over that of the second best.",
        chosen="By hand: Lowe's ratio.",
    )
    max_error_px: float = limit(
        4.0,
        "Largest reprojection error of an inlier, at the focal length of reference.",
        chosen="By hand: allows for the errors of depth and lens.",
    )
    min_inliers: int = limit(
        30, "Least number of inliers each way.", chosen="By hand: as many as make an answer sure."
    )
    min_inlier_share: float = limit(
        0.4, "Least share of the matches that are inliers.", chosen="By hand: look-alike places have fewer."
    )
    both_ways_m: float = limit(
        0.06,
        "Largest difference of the positions by the depth of the one frame and by that of the other.",
        chosen="By hand: what depth sensors are off by.",
    )
    both_ways_rad: float = limit(
        0.025, "The same of the attitude.", chosen="By hand: one and a half degrees."
    )


OPTIONS = LoopOptions()


@dataclass(frozen=True, slots=True)
class Seen:
    """What a frame sees: features, and their depth (n,), 0 where it has none."""

    features: LocalFeatures
    depth_m: NDArray[np.float32]


def measure_motion(a: Seen, b: Seen, camera: Camera, binary: bool) -> Pose | None:
    """Return `a_from_b` of two frames, None where they don't see the same place by their own depth both ways."""
    unit_a, unit_b = (to_unit_vectors(each.features.descriptors, binary) for each in (a, b))
    rows_a, rows_b, _ = match_unit_vectors(unit_a, unit_b, OPTIONS.ratio, binary)
    return motion_of_matches(a, rows_a, b, rows_b, camera)


def motion_of_matches(a: Seen, rows_a: Rows, b: Seen, rows_b: Rows, camera: Camera) -> Pose | None:
    """Return `a_from_b` by matches, rows (n,) of the features of both; None as `measure_motion`."""
    a_from_b = _pose_of(b, rows_b, a, rows_a, camera)
    b_from_a = None if a_from_b is None else _pose_of(a, rows_a, b, rows_b, camera)
    if a_from_b is None or b_from_a is None:
        return None
    back = b_from_a.inverse()
    agree = (
        position_difference_m(a_from_b, back) < OPTIONS.both_ways_m
        and attitude_difference_rad(a_from_b, back) < OPTIONS.both_ways_rad
    )
    return average_poses([a_from_b, back], robust=False) if agree else None


def _pose_of(seer: Seen, rows: Rows, other: Seen, other_rows: Rows, camera: Camera) -> Pose | None:
    """Return `other_from_seer`, of the camera that sees what the other frame has depth for."""
    depth_m = other.depth_m[other_rows]
    known = depth_m > 0
    if known.sum() < OPTIONS.min_inliers:
        return None
    points = camera.unproject(other.features.keypoints_px[other_rows[known]], depth_m[known])
    found = estimate_pose_lo_ransac(
        seer.features.keypoints_px[rows[known]],
        points,
        camera,
        max_error_px=tangent_of_px(OPTIONS.max_error_px) * camera.focal_px,
    )
    if found is None:
        return None
    inliers = int(found.inlier_mask.sum())
    enough = inliers >= max(OPTIONS.min_inliers, OPTIONS.min_inlier_share * known.sum())
    return found.world_from_camera if enough else None
