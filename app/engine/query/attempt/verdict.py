"""The outcome for the pose of one picture: its accuracy, the evidence for it, and whether it can be trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.query.accuracy import accuracy_in_map
from app.engine.query.attempt.few_inliers import OPTIONS as FEW
from app.engine.query.attempt.few_inliers import looks_otherwise
from app.engine.query.attempt.pose import Matcher, PoseSearch
from app.engine.query.attempt.rival import Contest
from app.engine.query.contradiction import OPTIONS as CONTRADICTION
from app.engine.query.contradiction import cells_of
from app.engine.query.hints import camera_hints, view_hints
from app.engine.query.intrinsics import CheckedCamera
from app.engine.query.localization import Localization
from app.engine.query.placed import with_camera
from app.engine.query.second.look import SecondMatcher
from app.engine.query.verification import Reason, confidence_with, evidence_of, judge


def conclude(
    search: PoseSearch,
    matcher: Matcher,
    contest: Contest,
    checked: CheckedCamera,
    sigmas: tuple[float, float],
) -> Localization:
    """Return the outcome for a pose that a rival may dispute, by a camera that was checked.

    `sigmas` are those of the camera's focal length (relative) and of its lens coefficient. What contradicts the pose is
    searched for only where nothing else does.
    """
    best, rival, inliers = contest.best, contest.rival, contest.best.inliers
    opened, query, camera = search.map, matcher.query, checked.camera
    judged = opened.artifact, inliers, camera, best.pose, *sigmas
    own = accuracy_in_map(*judged)
    whole = accuracy_in_map(*judged, checked.centre_sigma_px) if checked.centre_sigma_px else own
    accuracy, among = with_camera(whole, checked.systematic, checked.among, opened.artifact.metadata)
    if checked.trust == "contradicted":
        own = own.with_more(checked.systematic)
    sigma_m = own.with_map_error(opened.artifact.metadata).position_m
    retrieval = opened.retrieval
    distance_m = retrieval.distance_m(best.pose)
    similarity = retrieval.similarity_elsewhere(contest.leading, search.settings.look_alikes, query.allowed)
    visible = retrieval.covisible(best.pose, CONTRADICTION.keyframes, set(), query.allowed)
    unrepeated = matcher.unrepeated_count(inliers)
    agreement = matcher.agreement(best.pose, camera) if isinstance(matcher, SecondMatcher) else None
    evidence = replace(
        evidence_of(best.matches, inliers, camera, distance_m, None if rival is None else rival.inliers),
        position_sigma_m=own.position_m,
        unrepeated=unrepeated,
        similarity_elsewhere=similarity,
        agreement=agreement,
    )
    reason = judge(evidence, sigma_m, search.limits)
    if reason is None:
        seen, binary = (matcher.features, inliers.points_px), opened.extractor.binary
        cells = cells_of(opened.artifact, visible, best.pose, camera, *seen, binary)
        evidence = replace(evidence, contradicted=cells.contradicted_share)
        reason = judge(evidence, sigma_m, search.limits)
    is_few = evidence.inliers < FEW.max_inliers
    if reason is None and checked.trust == "disputed":
        reason = "ambiguous"
    elif reason is None and is_few and looks_otherwise(search, matcher, best.pose, camera):
        reason = "too_few_inliers"
    found = Localization(
        evidence=evidence,
        world_from_camera=best.pose,
        accuracy=accuracy,
        accuracy_among=among,
        confidence=confidence_with(evidence, accuracy, checked.trust),
        keyframes=contest.votes,
        camera=camera,
        timings_ms=query.timings_ms,
        candidate=best.pose,
        camera_trust=checked.trust,
        inliers=inliers,
    )
    return found if reason is None else _refused(found, reason, inliers.points_px, query.size_px)


def _refused(
    found: Localization, reason: Reason, inlier_px: NDArray[np.float64], size_px: tuple[int, int]
) -> Localization:
    """Return an outcome without its pose, with what may help; the features that agreed were at pixels (n, 2)."""
    hints = *camera_hints(found.camera_trust), *view_hints(reason, inlier_px, size_px)
    return replace(found.refused(reason), hints=hints)
