"""How well anchors locate: two pictures with known poses play the monitoring camera and the phone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec
from app.engine.anchors.features import AnchorDescriber, AnchorFeatures
from app.engine.anchors.locator import roll_deg
from app.engine.anchors.match_anchor import match_anchor
from app.engine.anchors.poi_triangulation import regions_in
from app.engine.anchors.verification import confidence_of_fix, judge_fix
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera
from app.vision.images import Rgb, to_gray

Array = NDArray[np.float64]

# The thesis's mean error.
GOOD_M = 0.46
# An answer with a larger error counts as wrong.
WRONG_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorPair:
    """Two pictures of one POI and the truth: the phone's place on the plan (2,), down in its axes (3,), the angle
    between the lines of sight at the POI, the POI's distance from the phone, and the names of the POIs it sees."""

    name: str
    spec: AnchorSpec
    monitor: Callable[[], Rgb]
    phone: Callable[[], Rgb]
    monitor_camera: Camera
    phone_camera: Camera
    phone_on_plan: Array
    gravity_in_phone: Array
    angle_deg: float
    distance_m: float
    seen: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorOutcome:
    """A pair's outcome; `error_m` is infinite for one that was not located, `position_sigma_m` NaN where a pipeline
    states none."""

    pair: AnchorPair
    error_m: float
    reason: str | None
    position_sigma_m: float
    confidence: float
    inliers: int

    @property
    def located(self) -> bool:
        """Whether there was an answer."""
        return self.reason is None


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorSummary:
    """Figures of some outcomes: shares in percent of all pairs, errors in metres of the located ones, `wrong_percent`
    the share of the located ones with an error above 1 m, `sigma_m` the median of the stated `accuracy`."""

    pairs: int
    located_percent: float
    good_percent: float
    mean_m: float | None
    median_m: float | None
    wrong_percent: float | None
    sigma_m: float | None

    def cells(self) -> tuple[str, ...]:
        """Return the figures as a table's cells."""
        values = (
            self.located_percent,
            self.good_percent,
            self.mean_m,
            self.median_m,
            self.wrong_percent,
            self.sigma_m,
        )
        return (str(self.pairs), *("-" if value is None else f"{value:g}" for value in values))


SUMMARY_HEAD = ("pairs", "located %", "within 0.46 m %", "mean m", "median m", "wrong by 1 m %", "accuracy m")


def summarize_outcomes(outcomes: Sequence[AnchorOutcome]) -> AnchorSummary:
    """Return the figures of outcomes."""
    errors = np.array([outcome.error_m for outcome in outcomes])
    located = np.array([outcome.located for outcome in outcomes], dtype=bool)
    if not located.any():
        return AnchorSummary(
            pairs=len(outcomes),
            located_percent=0.0,
            good_percent=0.0,
            mean_m=None,
            median_m=None,
            wrong_percent=None,
            sigma_m=None,
        )
    found = errors[located]
    stated = [o.position_sigma_m for o in outcomes if o.located and np.isfinite(o.position_sigma_m)]
    return AnchorSummary(
        pairs=len(outcomes),
        located_percent=round(100 * float(located.mean()), 1),
        good_percent=round(100 * float((located & (errors < GOOD_M)).mean()), 1),
        mean_m=round(float(found.mean()), 3),
        median_m=round(float(np.median(found)), 3),
        wrong_percent=round(100 * float((found > WRONG_M).mean()), 1),
        sigma_m=round(float(np.median(stated)), 3) if stated else None,
    )


class PairEvaluator:
    """Locates the phones of pairs, each by its own anchor alone."""

    def __init__(self, describer: AnchorDescriber) -> None:
        self.describer = describer
        self._monitors: dict[str, AnchorFeatures] = {}

    def monitor_features(self, pair: AnchorPair) -> AnchorFeatures:
        """Return the features of a pair's monitoring frame, kept between calls."""
        if pair.name not in self._monitors:
            self._monitors[pair.name] = self.describer.describe(
                pair.monitor(), pair.monitor_camera, regions_in(pair.spec, pair.monitor_camera)
            )
        return self._monitors[pair.name]

    def phone_features(self, rgb: Rgb, gravity: Array | None) -> AnchorFeatures:
        """Return the features of a phone picture, looked at upright where gravity says how it was held."""
        gray = to_gray(rgb)
        akaze = self.describer.akaze.extract(gray)
        roll = roll_deg(None if gravity is None else gravity.tolist())
        return self.describer.describe_phone(gray, akaze, roll)

    def alike_by_words(self, monitors: Sequence[AnchorFeatures], phone: AnchorFeatures) -> Array:
        """Return how much a phone's picture looks like each monitoring frame by visual words, (m,)."""
        return self.describer.alike_by_words(monitors, phone.akaze)

    def evaluate(
        self, pair: AnchorPair, change: Callable[[Rgb], Rgb] | None = None, *, with_gravity: bool = True
    ) -> AnchorOutcome:
        """Locate one phone; `change` is what light, lens or people do to its picture."""
        rgb = pair.phone() if change is None else change(pair.phone())
        camera = pair.phone_camera.scaled_to(rgb.shape[1], rgb.shape[0])
        gravity = pair.gravity_in_phone if with_gravity else None
        monitor, phone = self.monitor_features(pair), self.phone_features(rgb, gravity)
        fix, _ = match_anchor(
            pair.spec, (monitor, pair.monitor_camera), (phone, camera), gravity, None, StageTimer()
        )
        reason = "no_match" if fix is None else judge_fix(fix)
        if fix is None:
            return AnchorOutcome(
                pair=pair,
                error_m=float("inf"),
                reason=reason,
                position_sigma_m=0.0,
                confidence=0.0,
                inliers=0,
            )
        offset = fix.solution.plan_from_phone.translation[:2] - pair.phone_on_plan
        error = float(np.linalg.norm(offset)) if reason is None else float("inf")
        return AnchorOutcome(
            pair=pair,
            error_m=error,
            reason=reason,
            position_sigma_m=fix.position_sigma_m,
            confidence=confidence_of_fix(fix),
            inliers=fix.evidence.inliers,
        )


def tilted(pair: AnchorPair, angle_deg: float) -> AnchorPair:
    """Return the pair with its phone rolled about the optical axis, its picture turned about the principal point."""
    roll, camera = np.radians(angle_deg), pair.phone_camera
    cos, sin = float(np.cos(roll)), float(np.sin(roll))
    fx, fy, cx, cy = camera.params[:4]
    # Only a camera with square pixels and no lens sees a turned picture by a turn: the pinhole's own homography.
    K = camera.K
    warp = K @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]) @ np.linalg.inv(K)

    def turned() -> Rgb:
        rgb = cv2.undistort(pair.phone(), K, camera.distortion) if camera.is_distorted else pair.phone()
        return np.asarray(cv2.warpPerspective(rgb, warp, (camera.width, camera.height)), dtype=np.uint8)

    gravity = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]) @ pair.gravity_in_phone
    pinhole = Camera("PINHOLE", camera.width, camera.height, (fx, fy, cx, cy))
    return replace(pair, phone=turned, phone_camera=pinhole, gravity_in_phone=gravity)


def darker(share: float) -> Callable[[Rgb], Rgb]:
    """Return what a share of the light leaves of a picture, with the noise of a sensor that makes up for none."""

    def change(rgb: Rgb) -> Rgb:
        noise = np.random.default_rng(0).normal(0.0, 2.0, rgb.shape)
        return np.asarray(np.clip(share * rgb + noise, 0, 255), dtype=np.uint8)

    return change


def blurred(length_px: int) -> Callable[[Rgb], Rgb]:
    """Return what a sideways motion of that many pixels makes of a picture."""
    kernel = np.zeros((length_px, length_px), np.float32)
    kernel[length_px // 2] = 1.0 / length_px
    return lambda rgb: np.asarray(cv2.filter2D(rgb, -1, kernel), dtype=np.uint8)


def smaller(share: float) -> Callable[[Rgb], Rgb]:
    """Return a picture of that share of the resolution."""
    return lambda rgb: np.asarray(
        cv2.resize(rgb, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), dtype=np.uint8
    )


def with_people(count: int) -> Callable[[Rgb], Rgb]:
    """Return a picture with that many people standing in the way, as flat upright shapes."""

    def change(rgb: Rgb) -> Rgb:
        rng = np.random.default_rng(count)
        height, width = rgb.shape[:2]
        out = rgb.copy()
        for _ in range(count):
            u, tall = int(rng.uniform(0.05, 0.95) * width), rng.uniform(0.5, 0.9) * height
            color = tuple(int(value) for value in rng.integers(20, 200, 3))
            middle = (u, int(height - 0.35 * tall))
            cv2.ellipse(out, middle, (int(0.13 * tall), int(0.45 * tall)), 0, 0, 360, color, -1)
            cv2.circle(out, (u, int(height - 0.9 * tall)), int(0.09 * tall), color, -1)
        return out

    return change


CONDITIONS: dict[str, Callable[[Rgb], Rgb] | None] = {
    "as taken": None,
    "half resolution": smaller(0.5),
    "light 50 %": darker(0.5),
    "light 25 %": darker(0.25),
    "blur 5 px": blurred(5),
    "blur 11 px": blurred(11),
    "2 passers-by": with_people(2),
    "4 passers-by": with_people(4),
}
