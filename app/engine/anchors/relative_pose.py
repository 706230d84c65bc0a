"""The relative pose of phone and monitoring camera by their matches, and by both verticals where they are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.matching import PixelMatches
from app.geometry.anchor_pose import GRAVITY_SIGMA_RAD
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.epipolar import RelativePoseEstimate, estimate_relative_pose
from app.geometry.estimators.relative_refinement import KnownVerticals
from app.geometry.se3 import Pose, rotation_angle_deg
from app.geometry.upright_relative import estimate_upright_relative_pose
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativePoseOptions:
    """RANSAC for the relative pose, and how many inliers it needs.

    A free pose is estimated from the matches alone, an upright pose from the matches and both verticals.
    """

    max_epipolar_error_px: float = limit(
        2.0,
        "Largest Sampson error of an inlier, at the reference focal length.",
        chosen="By hand; no measurement is recorded.",
    )
    min_inliers: int = limit(
        60,
        "Least number of inliers of a relative pose that is verified.",
        chosen="Measured: `roomfix evaluate-anchors --demo DIR --count 100`, seeds 1 to 3 (docs/anchors.md, Figures).",
    )
    min_inlier_ratio: float = limit(
        0.22,
        "Least ratio of inliers to matches of a free relative pose.",
        chosen="Measured: `roomfix evaluate-anchors --demo DIR --count 100`, seeds 1 to 3 (docs/anchors.md, Figures).",
    )
    min_upright_inlier_ratio: float = limit(
        0.19,
        "Least ratio of inliers to matches of an upright relative pose.",
        chosen="By hand: an upright pose has three unknowns instead of five, so chance finds fewer inliers for it.",
    )
    free_iterations: int = limit(
        2000,
        "Largest number of RANSAC iterations for a free pose.",
        chosen="Computed: with an inlier ratio of 0.22 five-point samples succeed with a probability of 64 %, and "
        "local optimization from worse samples mostly succeeds earlier.",
    )
    free_half_iterations: int = limit(
        1000,
        "Largest number of RANSAC iterations for a free pose by one half of the matches.",
        chosen="By hand: half of `free_iterations`.",
    )
    upright_samples: int = limit(
        300,
        "Number of RANSAC samples for an upright pose.",
        chosen="Computed: with an inlier ratio of 0.22 three-point samples succeed with a probability of 96 %.",
    )
    upright_half_samples: int = limit(
        200,
        "Number of RANSAC samples for an upright pose by one half of the matches.",
        chosen="By hand: two thirds of `upright_samples`.",
    )
    edges_sigma_deg: float = limit(
        1.0,
        "Standard deviation of a monitoring camera's vertical by the edges in its frame.",
        chosen="By hand: with the errors of the lens and of the mount.",
    )
    min_upright_support_ratio: float = limit(
        0.9,
        "Least ratio of an upright pose's inliers to a free pose's; below it the verticals are taken to be wrong.",
        chosen="By hand: with correct verticals an upright pose fits nearly all matches that any pose fits; the "
        "accelerometer of a phone that is shaken measures more than gravity.",
    )
    comparison_iterations: int = limit(
        300,
        "Largest number of RANSAC iterations for the free pose of that comparison.",
        chosen="By hand; no measurement is recorded.",
    )
    sure_upright_inlier_ratio: float = limit(
        0.6,
        "Ratio of inliers to matches from which an upright pose is not compared with a free pose.",
        chosen="By hand: a free pose can hardly have many more inliers.",
    )


OPTIONS = RelativePoseOptions()
MAX_EPIPOLAR_ERROR_TANGENT = tangent_of_px(OPTIONS.max_epipolar_error_px)
EDGES_SIGMA_RAD = float(np.radians(OPTIONS.edges_sigma_deg))


@dataclass(frozen=True, slots=True)
class PhoneBesideMonitor:
    """A relative pose, and the verticals that it was estimated with, None for a free pose."""

    estimate: RelativePoseEstimate
    verticals: KnownVerticals | None

    @property
    def information(self) -> Array | None:
        """The inverse covariance (3, 3) of the rotation by the verticals, or None."""
        return None if self.verticals is None else self.verticals.information()


def known_verticals(
    down_in_monitor: Array | None, gravity_in_phone: Array | None, mount_sigma_rad: float | None = None
) -> KnownVerticals | None:
    """Return both verticals (3,), or None when one isn't known.

    `mount_sigma_rad` is the standard deviation of a calibrated camera's vertical, None where edges show the vertical.
    """
    if down_in_monitor is None or gravity_in_phone is None:
        return None
    sigma = EDGES_SIGMA_RAD if mount_sigma_rad is None else mount_sigma_rad
    in_phone = np.asarray(gravity_in_phone, dtype=np.float64)
    return KnownVerticals(
        down_in_monitor, in_phone / np.linalg.norm(in_phone), float(np.hypot(sigma, GRAVITY_SIGMA_RAD))
    )


def min_inlier_ratio(is_upright: bool) -> float:
    """Return the least inlier ratio of an upright or of a free pose."""
    return OPTIONS.min_upright_inlier_ratio if is_upright else OPTIONS.min_inlier_ratio


def phone_beside_monitor(
    matches: PixelMatches, cameras: tuple[Camera, Camera], verticals: KnownVerticals | None
) -> PhoneBesideMonitor | None:
    """Return the relative pose of a phone, the second of `cameras`, to the first, or None without one."""
    upright = None if verticals is None else _upright(matches, cameras, verticals, OPTIONS.upright_samples)
    if upright is not None and _fits(upright, matches, cameras):
        return PhoneBesideMonitor(upright, verticals)
    free = _free(matches, cameras, OPTIONS.free_iterations)
    return None if free is None else PhoneBesideMonitor(free, None)


def _fits(upright: RelativePoseEstimate, matches: PixelMatches, cameras: tuple[Camera, Camera]) -> bool:
    """Return whether an upright pose has about as many inliers as a free pose."""
    count = np.count_nonzero(upright.inlier_mask)
    if count >= OPTIONS.sure_upright_inlier_ratio * len(matches):
        return True
    free = _free(matches, cameras, OPTIONS.comparison_iterations)
    return free is None or bool(
        count >= OPTIONS.min_upright_support_ratio * np.count_nonzero(free.inlier_mask)
    )


def instability_deg(
    matches: PixelMatches, cameras: tuple[Camera, Camera], found: PhoneBesideMonitor, sure_inliers: int
) -> float:
    """Return the difference, in degrees, between the relative pose and those estimated from each half of the matches.

    It is the larger one of rotation and direction, of the worse half; 180 where a half gives no pose, 0 with at least
    `sure_inliers` inliers. A wrong pose by chance or by one plane is not found again by both halves.
    """
    count = np.count_nonzero(found.estimate.inlier_mask)
    if count >= sure_inliers:
        return 0.0
    if count < OPTIONS.min_inliers or count < min_inlier_ratio(found.verticals is not None) * len(matches):
        return 180.0
    order = np.random.default_rng(0).permutation(len(matches))
    worst = 0.0
    for half in (order[::2], order[1::2]):
        half_matches = matches.take(half)
        if found.verticals is None:
            again = _free(half_matches, cameras, OPTIONS.free_half_iterations)
        else:
            again = _upright(half_matches, cameras, found.verticals, OPTIONS.upright_half_samples)
        if again is None:
            return 180.0
        worst = max(worst, _apart_deg(again.b_from_a, found.estimate.b_from_a))
    return worst


def _apart_deg(one: Pose, other: Pose) -> float:
    """Return the larger of the differences of two relative poses in rotation and in direction, in degrees."""
    turned = rotation_angle_deg(one.rotation.T @ other.rotation)
    cosine = float(one.translation @ other.translation)
    return max(turned, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _upright(
    matches: PixelMatches, cameras: tuple[Camera, Camera], verticals: KnownVerticals, samples: int
) -> RelativePoseEstimate | None:
    return estimate_upright_relative_pose(
        matches.monitor_px,
        matches.phone_px,
        *cameras,
        verticals,
        max_error_px=_max_error_px(cameras),
        samples=samples,
    )


def _free(
    matches: PixelMatches, cameras: tuple[Camera, Camera], iterations: int
) -> RelativePoseEstimate | None:
    return estimate_relative_pose(
        matches.monitor_px,
        matches.phone_px,
        *cameras,
        max_error_px=_max_error_px(cameras),
        max_iterations=iterations,
    )


def _max_error_px(cameras: tuple[Camera, Camera]) -> float:
    return MAX_EPIPOLAR_ERROR_TANGENT * 0.5 * (cameras[0].focal_px + cameras[1].focal_px)
