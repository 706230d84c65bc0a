"""Whether the matches of a query fit the camera that was stated for it: zoom, stabilisation and crops show here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from app.engine.query.hypothesis import Hypothesis
from app.engine.query.intrinsics_options import OPTIONS
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy
from app.engine.query.zooms import Zoom, agreement, limit_px_of, most_agreeing_zoom
from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.covariance import SIGMA_PER_MAD
from app.geometry.intrinsics_check import FreeIntrinsics, changed_camera, free_intrinsics, square_pixels
from app.geometry.pnp import PnpEstimate
from app.geometry.se3 import Pose, rotation_angle_deg

Search = Callable[[Matches], Camera | None]
# What the matches say of a stated camera: they confirm it, leave it open, contradict it, show another one, or fit quite
# another one better and not well; or that none was stated, and one was fitted to them.
CameraTrust = Literal["confirmed", "open", "contradicted", "refined", "disputed", "fitted"]


class Poses(Protocol):
    """Finds the poses that most of a picture's matches agree on."""

    def estimate(self, matches: Matches, camera: Camera, prior: Pose | None = None) -> Hypothesis | None:
        """Return the pose of a camera with its inliers, None when too few agree; `prior` is tried first."""

    def poses(
        self, matches: Matches, cameras: Sequence[Camera], max_iterations: int
    ) -> list[PnpEstimate | None]:
        """Return the pose by each of several cameras, None where too few agree."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedCamera:
    """The camera that an answer uses, the stated one or a refined one, and its pose.

    `systematic` is one standard deviation of the pose by what is not known of the camera: all matches share it, so that
    no covariance of theirs shows it; `among` is the part of it by which pictures of one camera may differ among each
    other (None: all of it). `centre_sigma_px` is the standard deviation of a principal point that nothing shows.
    `trust` is what the matches say of the stated camera; one that is not checked counts as confirmed.
    """

    camera: Camera
    best: Hypothesis
    systematic: Accuracy = Accuracy(0.0, 0.0)
    among: Accuracy | None = None
    centre_sigma_px: float = 0.0
    trust: CameraTrust = "confirmed"


def checked_camera(
    best: Hypothesis, camera: Camera, poses: Poses, search: Search, is_stated: bool, is_checked: bool
) -> CheckedCamera:
    """Return what the matches say of a camera: of one that was fitted to them, or of a stated one that is to be
    checked by `check_intrinsics`."""
    if not is_stated:
        return fitted_camera(best, camera)
    return (
        check_intrinsics(best, camera, poses, search)
        if is_checked
        else CheckedCamera(camera=camera, best=best)
    )


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
        return _open(best, camera, Accuracy(0.0, 0.0))
    is_doubted, is_verified = _is_doubted(fit, camera), fit.focal_sigma <= OPTIONS.unverified_sigma
    agree = best.estimate.inlier_mask
    few_agree = np.count_nonzero(agree) < OPTIONS.screened_share * len(agree)
    zoomed = most_agreeing_zoom(best, camera, poses.poses) if few_agree else None
    may_be_other = is_doubted or not is_verified or is_stretched or zoomed is not None
    refined = _refined(best, camera, fit, poses, search, zoomed) if may_be_other else None
    if refined is not None and (refined.leads_beyond or _has_moved_far(refined.checked.camera, camera)):
        # A longer zoom is not found. Or the pixels are not as stated, as of a picture that was stretched: a far centre
        # makes up for that, wrongly.
        left_open = _left_open(best, fit, is_doubted=True)
        return CheckedCamera(camera=camera, best=best, systematic=left_open, trust="disputed")
    if refined is not None:
        return refined.checked
    is_near = abs(fit.log_focal) <= OPTIONS.confirmed_log
    is_confirmed = not is_doubted and is_near and fit.focal_sigma <= OPTIONS.confirmed_sigma
    trust: CameraTrust = "contradicted" if is_doubted else "confirmed"
    if zoomed is not None and _disputes(zoomed, camera):
        trust = "disputed"
    elif not is_doubted and (
        is_stretched or zoomed is not None or not is_verified or (_is_flat(best) and not _is_shown(fit))
    ):
        # A check by one focal length doesn't show pixels that are not square.
        trust = "open"
    least = None
    if trust != "confirmed" or _is_flat(best):
        least = _by_focal_sigma(best, OPTIONS.open_sigma)
    by_matches = Accuracy(0.0, 0.0) if is_confirmed else _left_open(best, fit, is_doubted=is_doubted)
    if least is None:
        return CheckedCamera(camera=camera, best=best, systematic=by_matches)
    systematic = _at_least(by_matches, least)
    if trust == "open":
        return _open(best, camera, systematic)
    among = by_matches if trust == "confirmed" else None
    return CheckedCamera(camera=camera, best=best, systematic=systematic, among=among, trust=trust)


def _disputes(zoom: Zoom, stated: Camera) -> bool:
    """Whether a zoom that leads to no better camera leaves nothing to be believed: it is far from the stated one, and
    as many matches agree with it as with the pose."""
    return zoom.rivals_pose and abs(np.log(zoom.camera.focal_px / stated.focal_px)) > OPTIONS.max_disputed_log


def _open(best: Hypothesis, camera: Camera, among: Accuracy) -> CheckedCamera:
    """Return a stated camera that the matches leave open: the pose is as uncertain as a zoom that they don't show would
    make it, alike in all pictures of this camera."""
    unseen = _at_least(among, _by_focal_sigma(best, OPTIONS.unseen_sigma))
    return CheckedCamera(camera=camera, best=best, systematic=unseen, among=among, trust="open")


def _at_least(systematic: Accuracy, least: Accuracy) -> Accuracy:
    return replace(systematic, position_m=max(systematic.position_m, least.position_m))


def _has_moved_far(refined: Camera, stated: Camera) -> bool:
    """Whether a refined camera has a principal point that the stated one's can hardly have been."""
    across = abs(refined.params[2] - stated.params[2]) / stated.width
    down = abs(refined.params[3] - stated.params[3]) / stated.height
    return max(across, down) > OPTIONS.max_refined_offset_ratio


def fitted_camera(best: Hypothesis, camera: Camera) -> CheckedCamera:
    """Return a camera that nobody stated and that was fitted to the inliers of a pose, with its principal point in the
    middle of the picture."""
    return CheckedCamera(
        camera=camera,
        best=best,
        systematic=_by_focal_sigma(best, OPTIONS.fitted_sigma),
        centre_sigma_px=_centre_sigma_px(camera),
        trust="fitted",
    )


def _centre_sigma_px(camera: Camera) -> float:
    return OPTIONS.centre_sigma_share * max(camera.width, camera.height)


def _fit(found: Hypothesis, camera: Camera, *, keep_centre: bool = False) -> FreeIntrinsics | None:
    if found.inlier_features < OPTIONS.min_features:
        return None
    pixels, points = found.inliers.points_px, found.inliers.points_in_world
    return free_intrinsics(pixels, points, camera, found.pose, keep_centre=keep_centre)


def _is_flat(best: Hypothesis) -> bool:
    """Whether the inliers of a pose are nearly all at one depth."""
    depths = (best.inliers.points_in_world - best.pose.translation) @ best.pose.rotation[:, 2]
    middle = float(np.median(depths))
    return SIGMA_PER_MAD * float(np.median(np.abs(depths - middle))) < OPTIONS.min_depth_spread * middle


def _is_shown(fit: FreeIntrinsics) -> bool:
    """Whether what is not at the depth of a flat scene shows the stated focal length all the same."""
    return fit.focal_sigma <= OPTIONS.flat_sigma and abs(fit.log_focal) <= OPTIONS.flat_log


def _left_open(best: Hypothesis, fit: FreeIntrinsics, *, is_doubted: bool) -> Accuracy:
    """Return by how much another camera that the matches allow would change a pose.

    The camera that fits best is uncertain itself, by the focal length's sigma. Where that is large, or the stated
    camera doubted, the confidence says it.
    """
    may_be_sure = fit.focal_sigma <= OPTIONS.unverified_sigma and not is_doubted
    sigma = OPTIONS.sigma_factor * fit.focal_sigma if may_be_sure else 0.0
    by_sigma = _by_focal_sigma(best, sigma)
    apart, factor = best.pose.inverse() @ fit.pose, OPTIONS.truncation_factor
    turn_deg = rotation_angle_deg(apart.rotation)
    return Accuracy(
        max(factor * float(np.linalg.norm(apart.translation)), by_sigma.position_m),
        max(factor * turn_deg, float(np.degrees(sigma)) / 2),
    )


def _by_focal_sigma(best: Hypothesis, focal_sigma: float) -> Accuracy:
    """Return what a relative sigma of the focal length changes of a pose: it moves along its axis."""
    distances = np.linalg.norm(best.inliers.points_in_world - best.pose.translation, axis=1)
    return Accuracy(focal_sigma * float(np.median(distances)), 0.0)


def _is_doubted(fit: FreeIntrinsics, camera: Camera) -> bool:
    sure = max(OPTIONS.sure_doubt_log, OPTIONS.sure_doubt_sigmas * fit.focal_sigma)
    zoom = min(max(OPTIONS.doubt_log, OPTIONS.doubt_sigmas * fit.focal_sigma), sure)
    shift_px = OPTIONS.doubt_offset_share * max(camera.width, camera.height)
    shifts_px = np.maximum(shift_px, OPTIONS.doubt_sigmas * fit.offset_sigmas_px)
    return abs(fit.log_focal) > zoom or bool(np.any(np.abs(fit.offset_px) > shifts_px))


@dataclass(frozen=True, slots=True)
class _Start:
    """A camera from which refining starts, with the pose where one is known; whether refining keeps its principal
    point, and whether its focal length is only near the right one."""

    camera: Camera
    pose: Pose | None = None
    keeps_centre: bool = True
    is_rough: bool = False


@dataclass(frozen=True, slots=True)
class _Refined:
    """A camera that refining led to, how many features agree with it, and their cost; whether refining would have gone
    on to a longer or shorter focal length than it may."""

    checked: CheckedCamera
    agreeing: int
    cost: float
    keeps_centre: bool
    leads_beyond: bool = False


def _refined(
    best: Hypothesis,
    camera: Camera,
    fit: FreeIntrinsics,
    poses: Poses,
    search: Search,
    zoomed: Zoom | None,
) -> _Refined | None:
    """Return a camera with far more inliers than the stated one, None where refining leads to none."""
    starts = _starts(best, camera, fit, search, zoomed)
    limit_px = limit_px_of(best, camera)
    tried = [_refined_from(start, best, camera, poses, limit_px) for start in starts]
    ends = [end for end in tried if end is not None]
    if not ends:
        return None
    found = _simplest(_of_better_lens(ends, camera))
    is_sure = abs(fit.log_focal) > OPTIONS.sure_sigmas * fit.focal_sigma
    gain = OPTIONS.sure_gain_ratio if is_sure else OPTIONS.min_gain_ratio
    # The first pose may have missed some that agree with the stated camera too.
    again = poses.estimate(best.matches, camera, found.checked.best.pose)
    stated = best.inlier_features if again is None else max(best.inlier_features, again.inlier_features)
    if found.agreeing < gain * stated:
        return None
    most_agree = found.agreeing >= OPTIONS.sure_inlier_ratio * best.matches.feature_count
    share = OPTIONS.simpler_share if most_agree else OPTIONS.centred_share
    return replace(found, checked=_with_spread(found, ends, share))


def _of_better_lens(ends: Sequence[_Refined], stated: Camera) -> Sequence[_Refined]:
    """Return the ends with the stated lens, or those without it where the best of these is better than all with it."""
    own = [end for end in ends if end.checked.camera.model == stated.model]
    others = [end for end in ends if end.checked.camera.model != stated.model]
    if not own or not others:
        return ends
    best = min(others, key=lambda end: end.cost)
    is_better = best.cost + OPTIONS.simpler_share * best.agreeing < min(end.cost for end in own)
    return others if is_better else own


def _simplest(ends: Sequence[_Refined]) -> _Refined:
    """Return the first camera that costs hardly more than the best one; they begin with the fewest unknowns."""
    least_cost = min(end.cost for end in ends)
    for end in ends:
        share = OPTIONS.centred_share if end.keeps_centre else OPTIONS.simpler_share
        if end.cost <= least_cost + share * end.agreeing:
            return end
    return ends[-1]


def _with_spread(found: _Refined, ends: Sequence[_Refined], share: float) -> CheckedCamera:
    """Return a camera whose pose is at least as uncertain as the others that fit about as well differ from it.

    For the position, these are the ends whose cost exceeds the least one by at most `share` of the inliers.
    """
    least_cost, checked = min(end.cost for end in ends), found.checked

    def apart(most_share: float) -> list[Pose]:
        most_cost = max(found.cost, least_cost + most_share * found.agreeing)
        return [checked.best.pose.inverse() @ end.checked.best.pose for end in ends if end.cost <= most_cost]

    position_m = max(float(np.linalg.norm(each.translation)) for each in apart(share))
    orientation_deg = max(rotation_angle_deg(each.rotation) for each in apart(OPTIONS.centred_share))
    systematic = Accuracy(
        max(checked.systematic.position_m, position_m),
        max(checked.systematic.orientation_deg, orientation_deg),
    )
    return replace(checked, systematic=systematic)


def _refined_from(
    start: _Start, best: Hypothesis, stated: Camera, poses: Poses, limit_px: float
) -> _Refined | None:
    """Return the camera that refining from `start` leads to; each round fits the camera to the inliers of the last."""
    found, tried, prior = None, start.camera, start.pose
    for _ in range(OPTIONS.rough_rounds if start.is_rough else OPTIONS.rounds):
        if abs(np.log(tried.focal_px / stated.focal_px)) > OPTIONS.max_refined_log:
            return None if found is None else replace(found, leads_beyond=True)
        hypothesis = poses.estimate(best.matches, tried, prior)
        if hypothesis is None:
            break
        agreeing, cost = agreement(best.matches, tried, hypothesis.pose, limit_px)
        if found is not None and not _is_gain(found, agreeing, cost, is_rough=start.is_rough):
            break
        next_fit = _fit(hypothesis, tried, keep_centre=start.keeps_centre)
        checked = CheckedCamera(
            camera=tried,
            best=hypothesis,
            systematic=_uncertainty(hypothesis, next_fit, tried, stated),
            centre_sigma_px=_centre_sigma_px(tried),
            trust="refined",
        )
        found = _Refined(checked, agreeing, cost, start.keeps_centre)
        if next_fit is None:
            break
        tried, prior = next_fit.camera, next_fit.pose
    return found


def _is_gain(found: _Refined, agreeing: int, cost: float, *, is_rough: bool) -> bool:
    """Whether a round is so much better than the last that another one may be worth its time."""
    if is_rough:
        return cost < found.cost - OPTIONS.round_gain_share * found.agreeing
    return agreeing > OPTIONS.round_gain_ratio * found.agreeing


def _uncertainty(found: Hypothesis, fit: FreeIntrinsics | None, refined: Camera, stated: Camera) -> Accuracy:
    """Return by how much the pose of a refined camera may be wrong for want of its exact focal length, and of the
    principal point if that was moved: moving it looks nearly the same as turning the camera."""
    few = max(1.0, OPTIONS.refined_features / found.inlier_features) ** 0.5
    sigma = max(OPTIONS.refined_sigma * few, 0.0 if fit is None else fit.focal_sigma)
    moved_px = np.subtract(refined.principal_point_px, stated.principal_point_px)
    turn_deg = float(np.degrees(np.arctan2(np.linalg.norm(moved_px), refined.focal_px)))
    return replace(_by_focal_sigma(found, sigma), orientation_deg=OPTIONS.moved_centre_factor * turn_deg)


def _starts(
    best: Hypothesis, camera: Camera, fit: FreeIntrinsics, search: Search, zoomed: Zoom | None
) -> Iterator[_Start]:
    """Yield the cameras from which refining starts, fewest unknowns first."""
    others = [zoomed.camera] if zoomed is not None else []
    if abs(fit.log_focal) > OPTIONS.search_log or fit.focal_sigma > OPTIONS.unverified_sigma:
        searched = search(best.matches)
        if searched is not None:
            zoom = float(np.log(searched.focal_px / camera.focal_px))
            # Of pixels that are far from square one side may have a focal length that no lens has.
            with suppress(InvalidCameraError):
                others.append(changed_camera(camera, [zoom, 0.0, 0.0]))
    if camera.is_distorted:
        # A picture that was undistorted, with the numbers of the lens that took it.
        yield _Start(Camera("PINHOLE", camera.width, camera.height, camera.params[:4]))
    yield from (_Start(square) for square in square_pixels(camera))
    centred = _fit(best, camera, keep_centre=True)
    if centred is not None:
        yield _Start(centred.camera, centred.pose, is_rough=True)
    yield from (_Start(other, is_rough=True) for other in others)
    yield _Start(fit.camera, fit.pose, keeps_centre=False)
    yield from (_Start(other, keeps_centre=False) for other in others)
