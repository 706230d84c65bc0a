"""Whether the matches of a query fit the camera that was stated for it: zoom, stabilisation and crops show here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from app.engine.query.hypothesis import Hypothesis
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy
from app.engine.query.zooms import agreement, limit_px_of, most_agreeing_zoom
from app.geometry.camera import Camera
from app.geometry.covariance import SIGMA_PER_MAD
from app.geometry.intrinsics_check import FreeIntrinsics, changed_camera, free_intrinsics, square_pixels
from app.geometry.pnp import PnpEstimate
from app.geometry.se3 import Pose, rotation_angle_deg
from app.limits import limit

ON_ZOOMED = (
    "roomfix evaluate-cameras on RedKitchen, desk_rs and freiburg1_rpy; docs/figures/evaluate-cameras.md."
)
Search = Callable[[Matches], Camera | None]


class Poses(Protocol):
    """Finds the poses that most of a picture's matches agree on."""

    def estimate(self, matches: Matches, camera: Camera, prior: Pose | None = None) -> Hypothesis | None:
        """Return the pose of a camera with its inliers, None when too few agree; `prior` is tried first."""

    def poses(
        self, matches: Matches, cameras: Sequence[Camera], max_iterations: int
    ) -> list[PnpEstimate | None]:
        """Return the pose by each of several cameras, None where too few agree."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IntrinsicsCheckOptions:
    """When a stated camera is doubted, and when another one is used in its place."""

    min_features: int = limit(
        12, "Fewest inliers that a camera is checked with.", chosen="By hand: nine unknowns need five points."
    )
    doubt_log: float = limit(
        0.025, "Change of the focal length's logarithm from which on a camera is doubted.", chosen=ON_ZOOMED
    )
    doubt_offset_share: float = limit(
        0.04,
        "Offset of the principal point, over the image's longer side, that is doubted.",
        chosen=ON_ZOOMED,
    )
    doubt_sigmas: float = limit(2.0, "Sigmas by which a change must differ from none.", chosen=ON_ZOOMED)
    sure_doubt_log: float = limit(
        0.015, "As doubt_log, where the change is beyond sure_doubt_sigmas.", chosen=ON_ZOOMED
    )
    sure_doubt_sigmas: float = limit(
        3.0, "Sigmas by which a smaller change must differ from none.", chosen=ON_ZOOMED
    )
    unverified_sigma: float = limit(
        0.05,
        "Relative sigma of the focal length by the matches above which they don't verify a camera at all.",
        chosen=ON_ZOOMED,
    )
    min_depth_spread: float = limit(
        0.13,
        "Spread of the inliers' depths (1.4826 times the median absolute deviation, over the median) below which they "
        "don't verify a camera: of a flat scene, a longer focal length shows the same as a nearer place.",
        chosen=ON_ZOOMED,
    )
    unverified_confidence: float = limit(
        0.85,
        "Largest confidence of an answer whose stated camera its matches don't verify, or contradict.",
        chosen="By hand: below 0.9, where an answer counts as sure, and above the least confidence of an answer.",
    )
    max_refined_log: float = limit(
        0.92,
        "Largest change of the focal length's logarithm that refining may make.",
        chosen="By hand: a factor of 2.5, beyond any zoom of a picture that still shows its room. Of flat scenes a "
        "longer focal length from farther away shows the same.",
    )
    rounds: int = limit(4, "Most rounds of refining a doubted camera.", chosen=ON_ZOOMED)
    search_log: float = limit(
        0.12,
        "Change of the focal length's logarithm from which on all focal lengths are searched.",
        chosen=ON_ZOOMED,
    )
    min_gain_ratio: float = limit(
        1.12,
        "Inliers with the refined camera, over those with the stated one, from which on it is used.",
        chosen=ON_ZOOMED,
    )
    confirmed_sigma: float = limit(
        0.01,
        "Relative sigma of the focal length by the matches up to which they confirm a camera.",
        chosen=ON_ZOOMED,
    )
    confirmed_log: float = limit(
        0.005,
        "Change of the focal length's logarithm up to which matches confirm a camera: inliers of the stated one show "
        "only part of what another camera would change.",
        chosen=ON_ZOOMED,
    )
    round_gain_ratio: float = limit(
        1.02,
        "Inliers after a round of refining, over those before, up to which refining ends.",
        chosen="By hand: a free camera fits the map's errors too, and moves away from the right one.",
    )
    simpler_share: float = limit(
        0.05,
        "Cost by which a camera of fewer unknowns may exceed the least one, over its inliers, and still be preferred.",
        chosen="By hand: a twentieth of what an outlier costs; unknowns always lower the cost a little.",
    )
    sure_gain_ratio: float = limit(
        1.04,
        "As min_gain_ratio, where the change of the focal length is beyond sure_sigmas.",
        chosen=ON_ZOOMED,
    )
    sure_sigmas: float = limit(
        4.0, "Sigmas of the focal length beyond which a smaller gain is enough.", chosen=ON_ZOOMED
    )
    screened_share: float = limit(
        0.5,
        "Inliers over matches below which other zooms are tried: the inliers of a wrong camera can agree among each "
        "other, but are few.",
        chosen="By hand: half the matches of right cameras agree on ordinary pictures.",
    )
    sigma_factor: float = limit(
        1.75,
        "Factor on the focal length's sigma by the matches: it is the sigma of inliers of the stated camera, which are "
        "those that agree with it.",
        chosen=ON_ZOOMED,
    )
    truncation_factor: float = limit(
        1.5,
        "Factor on the change that another camera would make: it is estimated on inliers of the stated one, which "
        "leaves out what contradicts it most.",
        chosen=ON_ZOOMED,
    )
    refined_sigma: float = limit(
        0.055,
        "Relative standard deviation of a focal length that was refined by refined_features inliers or more: the "
        "errors of the map's points are common to all.",
        chosen=ON_ZOOMED,
    )
    refined_features: int = limit(
        100,
        "Inliers below which that standard deviation grows with the inverse of the root of their number.",
        chosen=ON_ZOOMED,
    )


OPTIONS = IntrinsicsCheckOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedCamera:
    """The camera that an answer uses, the stated one or a refined one, and its pose.

    `systematic` is one standard deviation of the pose by what is not known of the camera: all matches share it, so that
    no covariance of theirs shows it. `is_contradicted` says that the matches contradict the camera that is used;
    `max_confidence` is below 1 where they verify no camera.
    """

    camera: Camera
    best: Hypothesis
    systematic: Accuracy = Accuracy(0.0, 0.0)
    max_confidence: float = 1.0
    is_contradicted: bool = False
    is_refined: bool = False


def check_intrinsics(best: Hypothesis, camera: Camera, poses: Poses, search: Search) -> CheckedCamera:
    """Return the stated camera, or a refined one where the matches fit it far better.

    A camera that the matches confirm is taken as stated. Where they leave it open, or contradict it without showing
    which other camera it is, the pose is uncertain by what the other camera would change of it. `search` returns the
    pinhole of any focal length that most matches agree with.
    """
    is_stretched = bool(square_pixels(camera))
    fit, inliers = None, best.inliers
    if best.inlier_features >= OPTIONS.min_features:
        fit = free_intrinsics(inliers.points_px, inliers.points_in_world, camera, best.pose)
    if fit is None:
        return CheckedCamera(camera=camera, best=best, max_confidence=OPTIONS.unverified_confidence)
    is_doubted, is_verified = _is_doubted(fit, camera), fit.focal_sigma <= OPTIONS.unverified_sigma
    agree = best.estimate.inlier_mask
    few_agree = np.count_nonzero(agree) < OPTIONS.screened_share * len(agree)
    zoomed = most_agreeing_zoom(best, camera, poses.poses) if few_agree else None
    may_be_other = is_doubted or not is_verified or is_stretched or zoomed is not None
    refined = _refined(best, camera, fit, poses, search, zoomed) if may_be_other else None
    if refined is not None:
        return refined
    is_near = abs(fit.log_focal) <= OPTIONS.confirmed_log
    is_confirmed = not is_doubted and is_near and fit.focal_sigma <= OPTIONS.confirmed_sigma
    # A check by one focal length doesn't show pixels that are not square.
    is_sure = is_verified and not (is_doubted or is_stretched or zoomed is not None or _is_flat(best))
    return CheckedCamera(
        camera=camera,
        best=best,
        systematic=Accuracy(0.0, 0.0) if is_confirmed else _left_open(best, fit, is_doubted=is_doubted),
        max_confidence=1.0 if is_sure else OPTIONS.unverified_confidence,
        is_contradicted=is_doubted,
    )


def _is_flat(best: Hypothesis) -> bool:
    """Return whether the inliers of a pose are nearly all at one depth."""
    depths = (best.inliers.points_in_world - best.pose.translation) @ best.pose.rotation[:, 2]
    middle = float(np.median(depths))
    return SIGMA_PER_MAD * float(np.median(np.abs(depths - middle))) < OPTIONS.min_depth_spread * middle


def _left_open(best: Hypothesis, fit: FreeIntrinsics, *, is_doubted: bool) -> Accuracy:
    """Return by how much another camera that the matches allow would change a pose.

    The camera that fits best is uncertain itself, by the focal length's sigma. Where that is large, or the stated
    camera doubted, the confidence says it.
    """
    may_be_sure = fit.focal_sigma <= OPTIONS.unverified_sigma and not is_doubted
    unknown = _by_focal_sigma(best, OPTIONS.sigma_factor * fit.focal_sigma if may_be_sure else 0.0)
    apart, factor = best.pose.inverse() @ fit.pose, OPTIONS.truncation_factor
    turn_deg = rotation_angle_deg(apart.rotation)
    return Accuracy(
        max(factor * float(np.linalg.norm(apart.translation)), unknown.position_m),
        max(factor * turn_deg, unknown.orientation_deg),
    )


def _by_focal_sigma(best: Hypothesis, focal_sigma: float) -> Accuracy:
    """Return what a relative sigma of the focal length changes of a pose: it moves along its axis."""
    distances = np.linalg.norm(best.inliers.points_in_world - best.pose.translation, axis=1)
    return Accuracy(focal_sigma * float(np.median(distances)), float(np.degrees(focal_sigma)) / 2)


def _is_doubted(fit: FreeIntrinsics, camera: Camera) -> bool:
    sure = max(OPTIONS.sure_doubt_log, OPTIONS.sure_doubt_sigmas * fit.focal_sigma)
    zoom = min(max(OPTIONS.doubt_log, OPTIONS.doubt_sigmas * fit.focal_sigma), sure)
    shift_px = OPTIONS.doubt_offset_share * max(camera.width, camera.height)
    shifts_px = np.maximum(shift_px, OPTIONS.doubt_sigmas * fit.offset_sigmas_px)
    return abs(fit.log_focal) > zoom or bool(np.any(np.abs(fit.offset_px) > shifts_px))


@dataclass(frozen=True, slots=True)
class _Refined:
    """A camera that refining led to, how many features agree with it, and their cost."""

    checked: CheckedCamera
    agreeing: int
    cost: float


def _refined(
    best: Hypothesis,
    camera: Camera,
    fit: FreeIntrinsics,
    poses: Poses,
    search: Search,
    zoomed: Camera | None,
) -> CheckedCamera | None:
    """Return a camera with far more inliers than the stated one, None where refining leads to none."""
    starts = _starts(best, camera, fit, search, zoomed)
    limit_px = limit_px_of(best, camera)
    tried = [_refined_from(start, pose, best, camera, poses, limit_px) for start, pose in starts]
    ends = [end for end in tried if end is not None]
    if not ends:
        return None
    least_cost = min(end.cost for end in ends)
    found = next(end for end in ends if end.cost <= least_cost + OPTIONS.simpler_share * end.agreeing)
    is_sure = abs(fit.log_focal) > OPTIONS.sure_sigmas * fit.focal_sigma
    gain = OPTIONS.sure_gain_ratio if is_sure else OPTIONS.min_gain_ratio
    return found.checked if found.agreeing >= gain * best.inlier_features else None


def _refined_from(
    start: Camera,
    prior: Pose | None,
    best: Hypothesis,
    stated: Camera,
    poses: Poses,
    limit_px: float,
) -> _Refined | None:
    """Return the camera that refining from `start` leads to; each round fits the camera to the inliers of the last."""
    found, tried = None, start
    for _ in range(OPTIONS.rounds):
        if abs(np.log(tried.focal_px / stated.focal_px)) > OPTIONS.max_refined_log:
            break
        hypothesis = poses.estimate(best.matches, tried, prior)
        if hypothesis is None:
            break
        agreeing, cost = agreement(best.matches, tried, hypothesis.pose, limit_px)
        if found is not None and agreeing <= OPTIONS.round_gain_ratio * found.agreeing:
            break
        next_fit, inliers = None, hypothesis.inliers
        if hypothesis.inlier_features >= OPTIONS.min_features:
            next_fit = free_intrinsics(inliers.points_px, inliers.points_in_world, tried, hypothesis.pose)
        checked = CheckedCamera(
            camera=tried,
            best=hypothesis,
            systematic=_uncertainty(hypothesis, next_fit),
            max_confidence=OPTIONS.unverified_confidence,
            is_refined=True,
        )
        found = _Refined(checked, agreeing, cost)
        if next_fit is None:
            break
        tried, prior = next_fit.camera, next_fit.pose
    return found


def _uncertainty(found: Hypothesis, fit: FreeIntrinsics | None) -> Accuracy:
    """Return by how much the pose of a refined camera may be wrong for want of its exact focal length."""
    few = max(1.0, OPTIONS.refined_features / found.inlier_features) ** 0.5
    sigma = max(OPTIONS.refined_sigma * few, 0.0 if fit is None else fit.focal_sigma)
    return _by_focal_sigma(found, sigma)


def _starts(
    best: Hypothesis, camera: Camera, fit: FreeIntrinsics, search: Search, zoomed: Camera | None
) -> Iterator[tuple[Camera, Pose | None]]:
    """Yield the cameras from which refining starts, fewest unknowns first, with the pose where one is known."""
    for square in square_pixels(camera):
        yield square, None
    yield fit.camera, fit.pose
    if zoomed is not None:
        yield zoomed, None
    if abs(fit.log_focal) > OPTIONS.search_log or fit.focal_sigma > OPTIONS.unverified_sigma:
        searched = search(best.matches)
        if searched is not None:
            zoom = float(np.log(searched.focal_px / camera.focal_px))
            yield changed_camera(camera, [zoom, 0.0, 0.0]), None
