"""The pose of a monitoring camera in a map, by one full-size image, or the reason why it is not determined."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.map_depth import SeenPoints, points_seen
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.accuracy import accuracy_in_map
from app.engine.query.attempt.pose import poses_in_map
from app.engine.query.hypothesis import seen_from_one_side
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.query import Query
from app.engine.query.verification import Limits, evidence_of, judge
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import PnpEstimate
from app.geometry.se3 import Pose, rotation_angle_deg
from app.limits import limit
from app.vision.images import Rgb
from app.vision.local_features import create_fine_extractor

Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorPoseOptions:
    """Which keyframes a monitoring camera's image is matched with, and what its pose must pass.

    All fixes by the anchor rest on this pose, so that it needs more evidence than a phone's.
    """

    max_position_sigma_m: float = limit(
        0.05,
        "Largest standard deviation of the position.",
        chosen="By hand: what a calibration promises; measured errors are at most 1.4 cm (docs/anchors.md, Figures).",
    )
    max_orientation_sigma_deg: float = limit(
        0.5,
        "Largest standard deviation of the attitude.",
        chosen="By hand: what a calibration promises; measured errors are at most 0.21 degrees (docs/anchors.md, "
        "Figures).",
    )
    min_inliers: int = limit(
        50,
        "Least number of inliers.",
        chosen="By hand: more than for a phone, because all fixes rest on the pose.",
    )
    min_inlier_ratio: float = limit(
        0.03,
        "Least ratio of inliers to matches.",
        chosen="By hand: less than for a phone, because many features are matched with many keyframes.",
    )
    min_coverage: float = limit(
        0.2,
        "Least fraction of the image's grid cells that hold inliers.",
        chosen="By hand: more than for a phone, because all fixes rest on the pose.",
    )
    first_keyframes: int = limit(
        40,
        "Largest number of keyframes that are matched first, those most similar to the image.",
        chosen="By hand; no measurement is recorded.",
    )
    more_keyframes: int = limit(
        60,
        "Largest number of keyframes that are matched in each further round, those that see the same by the pose.",
        chosen="By hand; no measurement is recorded.",
    )
    rounds: int = limit(2, "Number of further rounds.", chosen="By hand; no measurement is recorded.")
    min_shared_points: int = limit(
        40,
        "Least number of a keyframe's points in the image for the keyframe to see the same.",
        chosen="By hand; no measurement is recorded.",
    )
    max_keyframe_distance_m: float = limit(
        14.0,
        "Largest distance of such a keyframe from the camera.",
        chosen="By hand; no measurement is recorded.",
    )
    min_view_cosine: float = limit(
        0.7,
        "Least cosine of the angle at such a point between the camera and the keyframe.",
        chosen="By hand: 45 degrees; features seldom match at wider angles.",
    )
    max_reprojection_error_px: float = limit(
        4.0,
        "Largest reprojection error of an inlier, at the reference focal length.",
        chosen="By hand; no measurement is recorded.",
    )
    first_iterations: int = limit(
        20_000,
        "Largest number of RANSAC iterations for the first pose.",
        chosen="Computed: with an inlier ratio of 0.06 samples of three succeed with a probability of 99 %.",
    )
    more_iterations: int = limit(
        5_000,
        "Largest number of RANSAC iterations for a pose with a prior pose.",
        chosen="By hand; no measurement is recorded.",
    )
    min_keyframe_inliers: int = limit(
        8,
        "Least number of inliers of a keyframe whose points the camera is taken to see.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = MonitorPoseOptions()
LIMITS = Limits(
    min_inliers=OPTIONS.min_inliers,
    min_inlier_ratio=OPTIONS.min_inlier_ratio,
    min_coverage=OPTIONS.min_coverage,
    max_position_sigma_m=OPTIONS.max_position_sigma_m,
)
MAX_REPROJECTION_ERROR_TANGENT = tangent_of_px(OPTIONS.max_reprojection_error_px)


@dataclass(frozen=True, slots=True)
class MonitorPose:
    """A monitoring camera in a map: its pose, the standard deviations of position and attitude, the number of inliers,
    and the map points that it sees."""

    world_from_camera: Pose
    position_sigma_m: float
    orientation_sigma_deg: float
    inliers: int
    seen: SeenPoints


def find_monitor(opened: OpenMap, camera: Camera, rgb: Rgb, near: Rows) -> MonitorPose | str:
    """Return a monitoring camera's pose by its RGB image (height, width, 3), or the part of a sentence that says why
    there is none.

    `near` are the keyframes (rows) around the position that was entered for the camera. The standard deviations of a
    returned pose are within `OPTIONS.max_position_sigma_m` and `OPTIONS.max_orientation_sigma_deg`.
    """
    if len(near) == 0:
        return "the map has no pictures from around it"
    artifact = opened.artifact
    extractor = create_fine_extractor(artifact.metadata.features)
    query = QueryMatcher(Query.of(rgb, camera, near), opened, extractor)
    matches = query.match(opened.similar(rgb, OPTIONS.first_keyframes, near))
    found = _estimate(artifact, matches, camera, None)
    for _ in range(OPTIONS.rounds if found is not None else 0):
        assert found is not None  # noqa: S101 - the loop ends where it is None
        sharing = sharing_keyframes(artifact, camera, found.world_from_camera, near)
        query.match(sharing[: OPTIONS.more_keyframes])
        matches = query.match_all([])
        found = _estimate(artifact, matches, camera, found.world_from_camera) or found
    if found is None:
        return "nothing that it sees is in the map"
    return _judged(opened, camera, matches, found)


def sharing_keyframes(
    artifact: MapArtifact, camera: Camera, world_from_camera: Pose, near: Rows
) -> list[int]:
    """Return those of the keyframes `near` (rows) that see what a camera at a pose sees, most common points first."""
    arrays, camera_from_world = artifact.arrays, world_from_camera.inverse()
    centre, shared = world_from_camera.translation, []
    for row in near.tolist():
        rows, keyframe = artifact.rows(row), arrays.positions[row]
        if rows.stop - rows.start < OPTIONS.min_shared_points:
            continue
        if np.linalg.norm(keyframe - centre) > OPTIONS.max_keyframe_distance_m:
            continue
        points = arrays.points_in_world[rows].astype(np.float64)
        same_side = seen_from_one_side(points, keyframe, centre, OPTIONS.min_view_cosine)
        count = np.count_nonzero(same_side & camera.contains(camera.project(camera_from_world.apply(points))))
        if count >= OPTIONS.min_shared_points:
            shared.append((int(count), row))
    return [row for _, row in sorted(shared, key=lambda item: (-item[0], item[1]))]


def _estimate(
    artifact: MapArtifact, matches: Matches, camera: Camera, prior: Pose | None
) -> PnpEstimate | None:
    iterations = OPTIONS.first_iterations if prior is None else OPTIONS.more_iterations
    return poses_in_map(artifact, matches, [camera], MAX_REPROJECTION_ERROR_TANGENT, iterations, prior)[0]


def _judged(opened: OpenMap, camera: Camera, matches: Matches, found: PnpEstimate) -> MonitorPose | str:
    """Return the pose with its accuracy, or why it is rejected."""
    artifact, pose = opened.artifact, found.world_from_camera
    max_position_m, max_orientation_deg = OPTIONS.max_position_sigma_m, OPTIONS.max_orientation_sigma_deg
    inliers = matches.take(found.inlier_mask)
    own = accuracy_in_map(artifact, inliers, camera, pose)
    apart_m, apart_deg = _halves_apart(artifact, matches, camera, pose)
    metadata = artifact.metadata
    position_m = float(np.hypot(max(own.position_m, apart_m), metadata.position_sigma_m))
    orientation_deg = float(np.hypot(max(own.orientation_deg, apart_deg), metadata.orientation_sigma_deg))
    evidence = evidence_of(matches, inliers, camera, opened.retrieval.distance_m(pose))
    evidence = replace(evidence, position_sigma_m=position_m)
    reason = judge(evidence, min(position_m, max_position_m), LIMITS)
    if reason is not None:
        return f"too little of what it sees is in the map ({reason}: {evidence.inliers} features agree)"
    if position_m > max_position_m or orientation_deg > max_orientation_deg:
        return (
            f"the map holds its pose only to {position_m:.2f} m and {orientation_deg:.1f} degrees, not to "
            f"{max_position_m:g} m and {max_orientation_deg:g} degrees"
        )
    seen = _seen(artifact, camera, pose, inliers)
    return MonitorPose(pose, position_m, orientation_deg, evidence.inliers, seen)


def _seen(artifact: MapArtifact, camera: Camera, pose: Pose, inliers: Matches) -> SeenPoints:
    """Return the map points that the camera sees."""
    rows, counts = np.unique(inliers.keyframes, return_counts=True)
    agreeing = rows[counts >= OPTIONS.min_keyframe_inliers].tolist()
    points = [artifact.arrays.points_in_world[artifact.rows(row)] for row in agreeing]
    everything = np.concatenate([np.zeros((0, 3)), *points]).astype(np.float64)
    return points_seen(camera, pose, inliers.points_px, inliers.points_in_world, everything)


def _halves_apart(artifact: MapArtifact, matches: Matches, camera: Camera, pose: Pose) -> tuple[float, float]:
    """Return half of the difference, in metres and degrees, between the poses by each half of the keyframes.

    The error of a keyframe's own pose is common to all matches with it, so that their scatter doesn't show it. Half of
    the difference between two halves is the standard deviation of their mean.
    """
    rows, counts = np.unique(matches.keyframes, return_counts=True)
    order = rows[np.argsort(-counts, kind="stable")]
    poses = []
    for half in (order[::2], order[1::2]):
        found = _estimate(artifact, matches.take(np.isin(matches.keyframes, half)), camera, pose)
        if found is None:
            return float("inf"), 180.0
        poses.append(found.world_from_camera)
    apart = poses[0].inverse() @ poses[1]
    return 0.5 * float(np.linalg.norm(apart.translation)), 0.5 * rotation_angle_deg(apart.rotation)
