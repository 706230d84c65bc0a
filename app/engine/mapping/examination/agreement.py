"""How well poses, camera and depth agree with what the pictures say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.evidence import Evidence
from app.engine.mapping.examination.limits import LIMITS
from app.geometry.camera import REFERENCE_FOCAL_PX, Camera
from app.geometry.triangulation import homogeneous
from app.importers.conventions import PoseArrays
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class AgreementOptions:
    """Which matches can be triangulated."""

    min_parallax_ratio: float = limit(
        2.0,
        "A pair is triangulated when its parallax is this many times what is wrong with its poses.",
        chosen="By hand: its depth is then known to a half, and on the right side.",
    )
    motion_ratio: float = limit(
        0.5,
        "Part of the motion during the shutter that counts as wrong with a pair's poses.",
        chosen="By hand: a picture's rows are on average half a shutter from its time.",
    )
    min_parallax_px: float = limit(
        5.0,
        "The least parallax of a triangulated match, at the focal length of reference.",
        chosen="By hand: a tenth of it is the error of a feature.",
    )
    along_ratio: float = limit(
        3.0,
        "Errors along epipolar lines are at most this many times those across them.",
        chosen="By hand: lines and motion are seldom parallel in all of a scan.",
    )
    min_front_parallax_px: float = limit(
        10.0,
        "The least parallax of a match that shows on which side of the cameras its point lies.",
        chosen="By hand: a degree, which good poses are not off between frames that agree otherwise.",
    )
    min_front_pairs: int = limit(
        2,
        "Pairs that show on which side of the cameras points lie.",
        chosen="By hand: one may be a false match.",
    )
    min_front_share: float = limit(
        0.5,
        "Right poses put the points of at least this share of these pairs in front.",
        chosen="By hand: the opposite motion puts nearly none there, the right one nearly all.",
    )


OPTIONS = AgreementOptions()


@dataclass(frozen=True, slots=True)
class Rays:
    """The matches of the evidence in image-plane coordinates, (m, 3), (m, 3) with z = 1, of one camera."""

    first: Array
    second: Array

    @staticmethod
    def of(evidence: Evidence, camera: Camera) -> Rays:
        """Return the rays that a camera has for the evidence's pixels."""
        return Rays(
            homogeneous(camera.normalize(evidence.first_px)),
            homogeneous(camera.normalize(evidence.second_px)),
        )


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well poses and a camera explain the matches.

    `score` is the usual epipolar error over what a right scan may have: at most 1 is right. It is infinite when the
    points would lie behind the cameras. `least_score` is its lower bound of one sigma, which few pairs leave far below
    it. `error_px` is the usual error at the focal length of reference;
    `front_share` the share of pairs whose points lie in front, NaN where too few show it.
    """

    score: float
    least_score: float
    error_px: float
    front_share: float


def agreement(evidence: Evidence, rays: Rays, poses: PoseArrays) -> Agreement:
    """Return how well poses (n, of the scan's frames) and a camera, by its rays, explain the matches."""
    relative = relative_poses(evidence, poses)
    errors_px = epipolar_errors(evidence, rays, relative) * REFERENCE_FOCAL_PX
    of_pairs = group_medians(errors_px, evidence.pair, evidence.pairs)
    share = _front_share(evidence, rays, relative, of_pairs)
    scores = of_pairs / evidence.tolerance_px
    score, least = float(np.median(scores)), least_median(scores)
    if share < OPTIONS.min_front_share:
        score = least = float("inf")
    return Agreement(score=score, least_score=least, error_px=float(np.median(of_pairs)), front_share=share)


def least_median(values: Array) -> float:
    """Return the lower bound of one sigma of the median of values (n,).

    How many of n values lie below the true median is binomial: its standard deviation is half the root of n.
    """
    count = len(values)
    if count == 0:
        return math.nan
    rank = max(0, math.ceil((count - math.sqrt(count)) / 2.0) - 1)
    return float(np.sort(values)[rank])


def misfit(evidence: Evidence, rays: Rays, poses: PoseArrays) -> float:
    """Return a smooth measure (0 to 1) of how badly poses and a camera explain the matches, for searches.

    The mean over matches of e^2 / (e^2 + c^2) with the error that a right scan may have without motion for c.
    """
    errors_px = epipolar_errors(evidence, rays, relative_poses(evidence, poses)) * REFERENCE_FOCAL_PX
    allowed = evidence.still_tolerance_px[evidence.pair]
    return float(np.mean(errors_px**2 / (errors_px**2 + allowed**2)))


def relative_poses(evidence: Evidence, poses: PoseArrays) -> PoseArrays:
    """Return `second_from_first` of each pair (p,)."""
    first, second = evidence.first, evidence.second
    back = poses.rotations[second].transpose(0, 2, 1)
    moved = poses.positions[first] - poses.positions[second]
    return PoseArrays(back @ poses.rotations[first], np.einsum("pij,pj->pi", back, moved))


def epipolar_errors(evidence: Evidence, rays: Rays, relative: PoseArrays) -> Array:
    """Return how far (m,) the matches are from their epipolar lines, to first order, in image-plane coordinates.

    Between cameras in one place there are no epipolar lines: then how far they are from the turned ray.
    """
    lengths = np.linalg.norm(relative.positions, axis=1)
    x, y, z = (relative.positions / np.maximum(lengths, 1e-12)[:, None]).T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    essential = (skew @ relative.rotations)[evidence.pair]
    line_second = np.einsum("mij,mj->mi", essential, rays.first)
    line_first = np.einsum("mji,mj->mi", essential, rays.second)
    slopes = np.sqrt((line_first[:, :2] ** 2).sum(axis=1) + (line_second[:, :2] ** 2).sum(axis=1))
    errors = np.abs(np.einsum("mi,mi->m", rays.second, line_second)) / np.maximum(slopes, 1e-15)
    still = lengths[evidence.pair] < 1e-9
    if still.any():
        turned = np.einsum("mij,mj->mi", relative.rotations[evidence.pair[still]], rays.first[still])
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = turned[:, :2] / turned[:, 2:] - rays.second[still, :2]
        errors[still] = np.where(turned[:, 2] > 1e-9, np.linalg.norm(moved, axis=1), 10.0) / np.sqrt(2.0)
    return np.asarray(np.minimum(errors, 10.0))


def triangulated(evidence: Evidence, rays: Rays, relative: PoseArrays) -> tuple[Array, Array, Array]:
    """Return the depths (m,), (m,) in both cameras at which matched rays meet, and the parallax (m,) as a tangent."""
    turned = np.einsum("mij,mj->mi", relative.rotations[evidence.pair], rays.first)
    shift = relative.positions[evidence.pair]
    seen = rays.second
    across = np.cross(turned, seen)
    squared = np.maximum((across**2).sum(axis=1), 1e-18)
    first_m = -np.einsum("mi,mi->m", np.cross(shift, seen), across) / squared
    second_m = -np.einsum("mi,mi->m", np.cross(shift, turned), across) / squared
    lengths = np.linalg.norm(turned, axis=1) * np.linalg.norm(seen, axis=1)
    return first_m, second_m, np.sqrt(squared) / lengths


def group_medians(values: Array, group: NDArray[np.intp], count: int) -> Array:
    """Return the median (count,) of the values (m,) of each group; `group` (m,) is sorted. NaN for an empty one."""
    bounds = np.searchsorted(group, np.arange(count + 1))
    return np.array([np.median(values[i:j]) if j > i else np.nan for i, j in pairwise(bounds)])


def wide_matches(
    evidence: Evidence, parallax_px: Array, of_pairs_px: Array
) -> tuple[NDArray[np.bool_], Array]:
    """Return which matches (m,) can be triangulated, and for each pair (p,) how exactly, as a sigma over the depth.

    A pair counts by its usual parallax: a wide one amid narrow ones is a false match. What is wrong with a pair's
    poses, `of_pairs_px` (p,) and what moves during the shutter, goes into its depths.
    """
    usual_px = group_medians(parallax_px, evidence.pair, evidence.pairs)
    error_px = np.maximum(of_pairs_px, LIMITS.min_noise_px)
    # What a late clock or a rolling shutter does across the epipolar lines, it does along them.
    shown_px = OPTIONS.along_ratio * np.maximum(error_px, np.median(error_px))
    wrong_px = np.hypot(error_px, np.minimum(OPTIONS.motion_ratio * evidence.motion_px, shown_px))
    counts = usual_px > np.maximum(OPTIONS.min_parallax_px, OPTIONS.min_parallax_ratio * wrong_px)
    counts &= of_pairs_px <= evidence.tolerance_px
    wide = counts[evidence.pair] & (parallax_px > 0.5 * usual_px[evidence.pair])
    return wide, wrong_px / usual_px


def _front_share(evidence: Evidence, rays: Rays, relative: PoseArrays, of_pairs_px: Array) -> float:
    first_m, second_m, parallax = triangulated(evidence, rays, relative)
    parallax_px = parallax * REFERENCE_FOCAL_PX
    wide, _ = wide_matches(evidence, parallax_px, of_pairs_px)
    wide &= parallax_px > OPTIONS.min_front_parallax_px
    votes = group_medians(
        ((first_m > 0) & (second_m > 0))[wide].astype(float), evidence.pair[wide], evidence.pairs
    )
    votes = votes[np.isfinite(votes)]
    return float(np.mean(votes)) if len(votes) >= OPTIONS.min_front_pairs else float("nan")
