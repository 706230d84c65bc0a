"""One answer from frames whose poses relative to frame 0 are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.engine.query.accuracy import sigma_across
from app.engine.query.camera import lens_of_query
from app.engine.query.contradiction import Cells, cells_in_map
from app.engine.query.hypothesis import Hypothesis
from app.engine.query.intrinsics import CheckedCamera, check_intrinsics
from app.engine.query.localization import Localization, votes_of
from app.engine.query.localizer import Localizer
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy, Support
from app.engine.query.several.frame import AskedFrame, as_given
from app.engine.query.several.hypothesis import RigHypothesis, rig_evidence
from app.engine.query.several.options import OPTIONS
from app.engine.query.several.search import RigSearch, motion_sigma
from app.engine.query.verification import Evidence, Reason, confidence_with, judge
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_accuracy
from app.geometry.lens import Lens
from app.geometry.pnp import PnpEstimate
from app.geometry.rigs.pose import rig_covariance
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m


def locate_with_motion(localizer: Localizer, frames: Sequence[AskedFrame]) -> Localization:
    """Return where frame 0 is by all frames, whose cameras are stated and whose motion is known.

    The generalized pose must pass the limits of a single picture's. Where it doesn't, frame 0 alone may still answer,
    unless another frame contradicts it: by a better place for all, or by a pose of its own. Of the frames that have one
    most must agree where frame 0 is, frame 0 among them if it has one; the others are left out.
    """
    alone = as_given(frames[0], frames[0].found, frames[0].world_from_given)
    kept = _undisputed(frames)
    if kept is None:
        return alone.refused("ambiguous")
    if len(kept) == len(frames):
        return _by_all(localizer, frames, alone)
    found = _by_all(localizer, kept, alone)
    return replace(found, frames=_support_of_all(found, frames, kept))


def _support_of_all(
    found: Localization, frames: Sequence[AskedFrame], kept: Sequence[AskedFrame]
) -> tuple[Support, ...]:
    """Return the support of all frames by the outcome for those that were kept: the others have no inliers."""
    if not found.frames:
        return ()
    supports = dict(zip(map(id, kept), found.frames, strict=True))
    return tuple(supports.get(id(frame), Support(0, frame.found.evidence.matches)) for frame in frames)


def _by_all(localizer: Localizer, frames: Sequence[AskedFrame], alone: Localization) -> Localization:
    """Return where frame 0 is by frames that don't contradict each other."""
    if any(frame.found.is_refined for frame in frames):
        # What was stated of a camera is wrong, and the motion may be for it.
        return alone
    search = _search(localizer, frames)
    starts = [frame.world_from_first for frame in frames]
    best = search.best([pose for pose in starts if pose is not None])
    if best is None:
        return alone
    rival = search.rival(best)
    if rival is not None and rival.count > best.count:
        best, rival = rival, best
    found = _concluded(localizer, frames, search, best, rival)
    if found is None:
        return alone
    if found.world_from_camera is not None or alone.world_from_camera is None:
        return found
    sigma_m = alone.evidence.position_sigma_m
    agrees = agree(alone.world_from_camera, best.world_from_first, sigma_m)
    return alone if agrees else alone.refused("ambiguous")


def _undisputed(frames: Sequence[AskedFrame]) -> list[AskedFrame] | None:
    """Return the frames without those whose own pose most others contradict; None where most don't agree where frame 0
    is, or not with frame 0's own pose."""
    located = [
        (frame, pose, _own_sigma_m(frame)) for frame in frames if (pose := frame.world_from_first) is not None
    ]
    groups = [
        [
            frame
            for frame, other, other_sigma_m in located
            if agree(one, other, math.hypot(sigma_m, other_sigma_m))
        ]
        for _, one, sigma_m in located
    ]
    group = max(groups, key=len, default=[])
    if len(group) < len(located) and 2 * len(group) <= len(located):
        return None
    out = [frame for frame, _, _ in located if not any(frame is each for each in group)]
    if any(frame is frames[0] for frame in out):
        return None
    return [frame for frame in frames if not any(frame is each for each in out)]


def _own_sigma_m(frame: AskedFrame) -> float:
    """Return the standard deviation of a located frame's position against the others': by its inliers, and where its
    camera was refined, which theirs may not have been, by all that is not known of it."""
    found = frame.found
    if found.is_refined and found.accuracy is not None:
        return found.accuracy.position_m
    return found.evidence.position_sigma_m


def agree(a: Pose, b: Pose, sigma_m: float) -> bool:
    """Whether two poses of frame 0 are one; `sigma_m` is the standard deviation of their distance by their inliers:
    what is not known of the camera is the same for both."""
    random_m = OPTIONS.max_sigmas * sigma_m
    near_m = OPTIONS.motion_tolerance_m + random_m
    # Inliers that leave the position open leave the rotation open as well: both move what the picture shows.
    near_deg = OPTIONS.motion_tolerance_deg + math.degrees(random_m / OPTIONS.usual_depth_m)
    turned_deg = float(np.degrees(attitude_difference_rad(a, b)))
    return position_difference_m(a, b) <= near_m and turned_deg <= near_deg


def _search(localizer: Localizer, frames: Sequence[AskedFrame]) -> RigSearch:
    return RigSearch(
        map=localizer.map,
        settings=localizer.settings,
        matchers=tuple(frame.matcher for frame in frames),
        cameras=tuple(_camera(localizer, frame, frames) for frame in frames),
        first_from_cameras=tuple(_motion(frame) for frame in frames),
    )


def _motion(frame: AskedFrame) -> Pose:
    assert frame.first_from_turned is not None  # noqa: S101 - frames without a motion are answered elsewhere
    return frame.first_from_turned


def _stated(frame: AskedFrame) -> Camera:
    assert frame.camera is not None  # noqa: S101 - as above
    return frame.camera


def _camera(localizer: Localizer, frame: AskedFrame, frames: Sequence[AskedFrame]) -> Camera:
    """Return the camera of a frame with the lens that it, or a frame of the same camera, was located with."""
    for other in (frame, *frames):
        fitted = other.found.camera
        is_located = other.found.world_from_camera is not None
        if is_located and fitted is not None and other.camera == frame.camera:
            return fitted
    lens = _lens(localizer, frame)
    return _stated(frame) if lens is None else lens.of(_stated(frame))


def _lens(localizer: Localizer, frame: AskedFrame) -> Lens | None:
    return (
        lens_of_query(localizer.map.artifact.metadata, frame.camera) if localizer.settings.fit_lens else None
    )


def _concluded(
    localizer: Localizer,
    frames: Sequence[AskedFrame],
    search: RigSearch,
    best: RigHypothesis,
    rival: RigHypothesis | None,
) -> Localization | None:
    """Return the outcome for the best pose, None where the matches fit another camera far better than the stated."""
    checked = _checked(localizer, frames, search, best)
    if checked.trust in ("refined", "disputed"):
        return None
    opened = localizer.map
    metadata, lens = opened.artifact.metadata, _lens(localizer, frames[0])
    own = _accuracy(search, best, 0.0 if lens is None else lens.sigma).with_more(_motion_sigma(frames, best))
    accuracy = own.with_more(checked.systematic).with_map_error(metadata)
    if checked.trust == "contradicted":
        own = own.with_more(checked.systematic)
    distance_m = opened.retrieval.distance_m(best.world_from_first)
    evidence = rig_evidence(best, rival, search.matchers, distance_m, own.position_m)
    evidence, reason = _judged(localizer, search, best, evidence, own.with_map_error(metadata).position_m)
    inliers, first = Matches.merge(best.inliers), frames[0]
    found = Localization(
        evidence=evidence,
        world_from_camera=best.world_from_first @ _motion(first),
        accuracy=accuracy,
        confidence=confidence_with(evidence, accuracy, checked.trust),
        keyframes=votes_of(Matches.merge(best.matches), inliers),
        camera=search.cameras[0],
        timings_ms=timings_of(frames),
        candidate=best.world_from_first,
        inliers=best.inliers[0],
        frames=best.frames,
    )
    placed = as_given(first, found, best.world_from_first)
    return placed if reason is None else replace(placed.refused(reason), hints=first.found.hints)


def _judged(
    localizer: Localizer, search: RigSearch, best: RigHypothesis, evidence: Evidence, position_sigma_m: float
) -> tuple[Evidence, Reason | None]:
    """Return the evidence with what contradicts the pose, and why the pose can't be trusted, None if it can."""
    reason = judge(evidence, position_sigma_m, localizer.limits)
    if reason is not None:
        return evidence, reason
    if not best.is_confirmed:
        return evidence, "too_few_inliers"
    cells = [
        cells_in_map(
            search.map,
            search.pose_of(best, frame),
            search.cameras[frame],
            matcher.features,
            best.inliers[frame].points_px,
            matcher.query.allowed,
        )
        for frame, matcher in enumerate(search.matchers)
    ]
    pooled = Cells(sum(each.against for each in cells), sum(each.supported for each in cells))
    evidence = replace(evidence, contradicted=pooled.contradicted_share)
    return evidence, judge(evidence, position_sigma_m, localizer.limits)


def _checked(
    localizer: Localizer, frames: Sequence[AskedFrame], search: RigSearch, best: RigHypothesis
) -> CheckedCamera:
    """Return what the frame with most inliers says of its camera."""
    most = max(range(len(frames)), key=lambda frame: best.frames[frame].inliers)
    camera = search.cameras[most]
    estimate = PnpEstimate(search.pose_of(best, most), best.masks[most], 0.0, 0)
    hypothesis = Hypothesis.of(estimate, best.matches[most])
    if not localizer.settings.check_intrinsics:
        return CheckedCamera(camera=camera, best=hypothesis)
    find = partial(localizer.search.find_camera, query=frames[most].matcher.query)
    return check_intrinsics(hypothesis, camera, localizer.search, find)


def _accuracy(search: RigSearch, best: RigHypothesis, lens_sigma: float) -> Accuracy:
    """Return how accurate frame 0's pose is by what counts; infinity for what that leaves open."""
    positions = search.map.artifact.arrays.positions
    sigmas: list[NDArray[np.float64]] = [
        sigma_across(
            own.sigma_m,
            own.points_in_world,
            positions[own.keyframes],
            search.pose_of(best, frame).translation,
        )
        for frame, own in enumerate(best.counted)
    ]
    views = search.views(best.counted)
    try:
        covariance = rig_covariance(views, best.world_from_first, sigmas, lens_sigma=lens_sigma)
    except DegenerateGeometryError:
        return Accuracy(float("inf"), 180.0)
    return Accuracy(*pose_accuracy(covariance))


def _motion_sigma(frames: Sequence[AskedFrame], best: RigHypothesis) -> Accuracy:
    """Return by how much an error of the motion may move frame 0, by the share of the inliers in other frames."""
    counts = np.array([own.feature_count for own in best.counted], dtype=np.float64)
    sigmas = [Accuracy(0.0, 0.0), *(motion_sigma(_motion(frame)) for frame in frames[1:])]
    weights = counts / max(float(counts.sum()), 1.0)
    return Accuracy(
        float(weights @ [each.position_m for each in sigmas]),
        float(weights @ [each.orientation_deg for each in sigmas]),
    )


def timings_of(frames: Sequence[AskedFrame]) -> dict[str, float]:
    """Return the milliseconds of all frames by stage so far; what no other stage took is the pose's."""
    queries = [frame.matcher.query for frame in frames]
    total_ms = sum(queries[0].timings_ms.values())
    stages = {stage: 1e3 * sum(query.spent_s[stage] for query in queries) for stage in queries[0].spent_s}
    return {**stages, "pose": total_ms - sum(stages.values())}
