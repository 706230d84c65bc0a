"""Where a fixed camera hangs in a map: its pose from all that one full-size picture tells, or why it stays unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.map_depth import SeenPoints, points_seen
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.accuracy import accuracy_in_map, seen_from_one_side
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.pose import pose_in_map
from app.engine.query.query import Query
from app.engine.query.verification import Limits, evidence_of, judge
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.pnp import PnpEstimate
from app.geometry.se3 import Pose, rotation_angle_deg
from app.vision.images import Rgb
from app.vision.local_features import create_fine_extractor

Rows = NDArray[np.int64]

# What a calibration promises: one sigma of the pose, in metres and degrees.
MAX_POSITION_SIGMA_M, MAX_ORIENTATION_SIGMA_DEG = 0.05, 0.5
# Every frame that the camera pushes hangs on this pose: more must speak for it than for a phone's. The share of the
# matches says less, for the picture has many features and is matched with many keyframes.
LIMITS = Limits(
    min_inliers=50, min_inlier_ratio=0.03, min_coverage=0.2, max_position_sigma_m=MAX_POSITION_SIGMA_M
)
# Matched first: those that look most like the picture; then those that must see the same by the pose so far.
FIRST_KEYFRAMES, MORE_KEYFRAMES, ROUNDS = 40, 60, 2
# A keyframe sees what a pose sees when so many of its points lie in the picture, are this near, and are seen from
# within 45 degrees of its own direction.
MIN_SHARED_POINTS, MAX_DISTANCE_M, MIN_COSINE = 40, 14.0, 0.7
# The inlier limit as an angle (tangent).
MAX_ERROR = tangent_of_px(4.0)
# A share of inliers of 0.06 is found by samples of three in so many tries.
FIRST_ITERATIONS, MORE_ITERATIONS = 20_000, 5_000
# Of a keyframe that takes part in a pose at least so many matches agree with it.
MIN_KEYFRAME_INLIERS = 8


@dataclass(frozen=True, slots=True)
class MonitorPose:
    """A fixed camera in a map: its pose, one sigma of it in metres and degrees, how many of its features agree, and
    how far away what it sees is."""

    world_from_camera: Pose
    position_sigma_m: float
    orientation_sigma_deg: float
    inliers: int
    seen: SeenPoints


def find_monitor(opened: OpenMap, camera: Camera, rgb: Rgb, near: Rows) -> MonitorPose | str:
    """Return a fixed camera's pose by its RGB image (height, width, 3), or a sentence's part that says why not.

    `near` are the keyframes (rows) around the place where the camera is known to hang. A pose is not returned
    unless one sigma of it is within 5 cm and 0.5 degrees.
    """
    if len(near) == 0:
        return "the map has no pictures from around it"
    artifact = opened.artifact
    extractor = create_fine_extractor(artifact.metadata.features)
    query = QueryMatcher(Query.of(rgb, camera, near), opened, extractor)
    matches = query.match(opened.similar(rgb, FIRST_KEYFRAMES, near))
    found = _estimate(artifact, matches, camera, None)
    for _ in range(ROUNDS if found is not None else 0):
        assert found is not None  # noqa: S101 - the loop ends where it is None
        query.match(sharing_keyframes(artifact, camera, found.world_from_camera, near)[:MORE_KEYFRAMES])
        matches = query.match_all([])
        found = _estimate(artifact, matches, camera, found.world_from_camera) or found
    if found is None:
        return "nothing that it sees is in the map"
    return _judged(opened, camera, matches, found)


def sharing_keyframes(
    artifact: MapArtifact, camera: Camera, world_from_camera: Pose, near: Rows
) -> list[int]:
    """Return those of some keyframes that see what a camera at a pose sees, most points first."""
    arrays, camera_from_world = artifact.arrays, world_from_camera.inverse()
    centre, shared = world_from_camera.translation, []
    for row in near.tolist():
        rows, keyframe = artifact.rows(row), arrays.positions[row]
        if rows.stop - rows.start < MIN_SHARED_POINTS or np.linalg.norm(keyframe - centre) > MAX_DISTANCE_M:
            continue
        points = arrays.points_in_world[rows].astype(np.float64)
        alike = seen_from_one_side(points, keyframe, centre, MIN_COSINE)
        count = np.count_nonzero(alike & camera.contains(camera.project(camera_from_world.apply(points))))
        if count >= MIN_SHARED_POINTS:
            shared.append((int(count), row))
    return [row for _, row in sorted(shared, key=lambda item: (-item[0], item[1]))]


def _estimate(
    artifact: MapArtifact, matches: Matches, camera: Camera, prior: Pose | None
) -> PnpEstimate | None:
    iterations = FIRST_ITERATIONS if prior is None else MORE_ITERATIONS
    return pose_in_map(artifact, matches, camera, MAX_ERROR, iterations, prior)


def _judged(opened: OpenMap, camera: Camera, matches: Matches, found: PnpEstimate) -> MonitorPose | str:
    artifact, pose = opened.artifact, found.world_from_camera
    inliers = matches.take(found.inlier_mask)
    own = accuracy_in_map(artifact, inliers, camera, pose)
    apart_m, apart_deg = _halves_apart(artifact, matches, camera, pose)
    metadata = artifact.metadata
    position_m = float(np.hypot(max(own.position_m, apart_m), metadata.position_sigma_m))
    orientation_deg = float(np.hypot(max(own.orientation_deg, apart_deg), metadata.orientation_sigma_deg))
    evidence = evidence_of(matches, inliers, camera, opened.retrieval.distance_m(pose))
    evidence = replace(evidence, position_sigma_m=position_m)
    reason = judge(evidence, min(position_m, MAX_POSITION_SIGMA_M), LIMITS)
    if reason is not None:
        return f"too little of what it sees is in the map ({reason}: {evidence.inliers} features agree)"
    if position_m > MAX_POSITION_SIGMA_M or orientation_deg > MAX_ORIENTATION_SIGMA_DEG:
        return (
            f"the map holds its pose only to {position_m:.2f} m and {orientation_deg:.1f} degrees, not to "
            f"{MAX_POSITION_SIGMA_M:g} m and {MAX_ORIENTATION_SIGMA_DEG:g} degrees"
        )
    seen = _seen(artifact, camera, pose, inliers)
    return MonitorPose(pose, position_m, orientation_deg, evidence.inliers, seen)


def _seen(artifact: MapArtifact, camera: Camera, pose: Pose, inliers: Matches) -> SeenPoints:
    rows, counts = np.unique(inliers.keyframes, return_counts=True)
    agreeing = rows[counts >= MIN_KEYFRAME_INLIERS].tolist()
    points = [artifact.arrays.points_in_world[artifact.rows(row)] for row in agreeing]
    everything = np.concatenate([np.zeros((0, 3)), *points]).astype(np.float64)
    return points_seen(camera, pose, inliers.points_px, inliers.points_in_world, everything)


def _halves_apart(artifact: MapArtifact, matches: Matches, camera: Camera, pose: Pose) -> tuple[float, float]:
    """Return half of what the poses by either half of the keyframes differ by, in metres and degrees.

    What all matches with one keyframe share, the error of its own pose, doesn't show in their scatter. Half of the
    difference of two halves is one sigma of their mean.
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
