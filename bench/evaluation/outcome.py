"""What the localizer found for one query, compared with the true pose."""

from __future__ import annotations

from app.engine.query.localization import Localization
from app.geometry.se3 import Pose
from bench.evaluation.pose_errors import QueryOutcome, pose_error


def outcome_of(name: str, found: Localization, truth: Pose | None, milliseconds: float) -> QueryOutcome:
    """Return the outcome of a query whose true `world_from_camera` is given; without one, as for a place that is
    not in the map, any pose is infinitely far off."""
    estimate, evidence = found.world_from_camera, found.evidence
    position_m, orientation_deg = float("inf"), 180.0
    if estimate is not None and truth is not None:
        position_m, orientation_deg = pose_error(estimate, truth)
    candidate_m = candidate_deg = None
    if found.candidate is not None:
        candidate_m, candidate_deg = (
            (float("inf"), 180.0) if truth is None else pose_error(found.candidate, truth)
        )
    return QueryOutcome(
        name=name,
        located=estimate is not None,
        position_m=position_m,
        orientation_deg=orientation_deg,
        reason=found.reason,
        inliers=evidence.inliers,
        confidence=found.confidence,
        milliseconds=milliseconds,
        matches=evidence.matches,
        inlier_ratio=evidence.inlier_ratio,
        coverage=evidence.coverage,
        rival_share=evidence.rival / evidence.inliers if evidence.inliers else 0.0,
        keyframe_distance_m=evidence.keyframe_distance_m,
        sigma_m=None if found.accuracy is None else found.accuracy.position_m,
        sigma_deg=None if found.accuracy is None else found.accuracy.orientation_deg,
        truth_m=None if truth is None else centre_of(truth),
        distinct_share=evidence.distinct_share,
        candidate_m=candidate_m,
        candidate_deg=candidate_deg,
        position_sigma_m=evidence.position_sigma_m,
        unrepeated_share=evidence.unrepeated_share,
        contradicted_share=evidence.contradicted,
        estimate_m=None if estimate is None else centre_of(estimate),
        camera_trust=found.camera_trust,
    )


def centre_of(world_from_camera: Pose) -> tuple[float, float, float]:
    """Return the camera's centre in the world as plain numbers, rounded to 0.1 mm."""
    x, y, z = (round(float(value), 4) for value in world_from_camera.translation)
    return x, y, z
