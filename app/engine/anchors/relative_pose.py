"""How a phone stands beside a monitoring camera by their matches, and by both verticals where they are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.features import PixelMatches
from app.geometry.anchor_pose import GRAVITY_SIGMA_RAD
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.epipolar import RelativePoseEstimate, estimate_relative_pose
from app.geometry.se3 import Pose, rotation_angle_deg
from app.geometry.upright_relative import KnownVerticals, estimate_upright_relative_pose

Array = NDArray[np.float64]

# The inlier limit as an angle (tangent): two pixels of a 640-pixel picture at an ordinary focal length.
MAX_ERROR = tangent_of_px(2.0)
# With fewer inliers, or a smaller share of the matches, an answer is not looked at any further.
MIN_INLIERS, MIN_INLIER_RATIO = 60, 0.22
# Chance finds fewer matches for a pose that both verticals hold: it has three unknowns instead of five.
MIN_UPRIGHT_INLIER_RATIO = 0.19
# A share of inliers that passes, 0.22, is found by five-point samples in 2000 tries with 64 % chance, and by local
# optimization from worse samples mostly before.
ITERATIONS, HALF_ITERATIONS = 2000, 1000
# Three-point samples find it in 300 tries with 96 % chance.
SAMPLES, HALF_SAMPLES = 300, 200
# Edges in a monitoring camera's picture tell its vertical about that well, lens and mount included.
EDGES_SIGMA_RAD = float(np.radians(1.0))
# A pose that right verticals hold fits nearly all matches that any pose fits, found in so many tries; with less than
# this share a vertical was wrong: a phone that is shaken feels more than gravity.
MIN_SUPPORT, COMPARED_ITERATIONS = 0.9, 300
# With such a share of the matches there is hardly room for a better one.
SURE_RATIO = 0.6


@dataclass(frozen=True, slots=True)
class PhoneBesideMonitor:
    """A relative pose, and the verticals that it was held to, None where it rests on the matches alone."""

    estimate: RelativePoseEstimate
    verticals: KnownVerticals | None

    @property
    def information(self) -> Array | None:
        """What the verticals say of the rotation, (3, 3), or None."""
        return None if self.verticals is None else self.verticals.information()


def known_verticals(
    down_in_monitor: Array | None, gravity_in_phone: Array | None, mount_sigma_rad: float | None = None
) -> KnownVerticals | None:
    """Return both verticals, or None when one isn't known. `mount_sigma_rad` is of a calibrated camera's."""
    if down_in_monitor is None or gravity_in_phone is None:
        return None
    sigma = EDGES_SIGMA_RAD if mount_sigma_rad is None else mount_sigma_rad
    in_phone = np.asarray(gravity_in_phone, dtype=np.float64)
    return KnownVerticals(
        down_in_monitor, in_phone / np.linalg.norm(in_phone), float(np.hypot(sigma, GRAVITY_SIGMA_RAD))
    )


def min_inlier_ratio(is_upright: bool) -> float:
    """Return the share of the matches that a pose needs, by whether both verticals hold it."""
    return MIN_UPRIGHT_INLIER_RATIO if is_upright else MIN_INLIER_RATIO


def phone_beside_monitor(
    matches: PixelMatches, cameras: tuple[Camera, Camera], verticals: KnownVerticals | None
) -> PhoneBesideMonitor | None:
    """Return the pose of a phone, the second of `cameras`, beside the first, or None when the matches hold none."""
    upright = None if verticals is None else _upright(matches, cameras, verticals, SAMPLES)
    if upright is not None and _fits(upright, matches, cameras):
        return PhoneBesideMonitor(upright, verticals)
    free = _free(matches, cameras, ITERATIONS)
    return None if free is None else PhoneBesideMonitor(free, None)


def _fits(upright: RelativePoseEstimate, matches: PixelMatches, cameras: tuple[Camera, Camera]) -> bool:
    """Return whether a pose that verticals hold fits the matches about as well as any does."""
    count = np.count_nonzero(upright.inlier_mask)
    if count >= SURE_RATIO * len(matches):
        return True
    free = _free(matches, cameras, COMPARED_ITERATIONS)
    return free is None or bool(count >= MIN_SUPPORT * np.count_nonzero(free.inlier_mask))


def instability_deg(
    matches: PixelMatches, cameras: tuple[Camera, Camera], found: PhoneBesideMonitor, sure_inliers: int
) -> float:
    """Return how far off, in degrees, the relative pose is by either half of the matches alone; 0 with `sure_inliers`.

    A wrong pose that chance or one plane made plausible doesn't come out twice.
    """
    count = np.count_nonzero(found.estimate.inlier_mask)
    if count >= sure_inliers:
        return 0.0
    if count < MIN_INLIERS or count < min_inlier_ratio(found.verticals is not None) * len(matches):
        return 180.0
    order = np.random.default_rng(0).permutation(len(matches))
    worst = 0.0
    for half in (order[::2], order[1::2]):
        some = matches.take(half)
        if found.verticals is None:
            again = _free(some, cameras, HALF_ITERATIONS)
        else:
            again = _upright(some, cameras, found.verticals, HALF_SAMPLES)
        if again is None:
            return 180.0
        worst = max(worst, _apart_deg(again.b_from_a, found.estimate.b_from_a))
    return worst


def _apart_deg(one: Pose, other: Pose) -> float:
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
    return MAX_ERROR * 0.5 * (cameras[0].focal_px + cameras[1].focal_px)
