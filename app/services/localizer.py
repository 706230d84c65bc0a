"""The localization pipeline on one map: describe, retrieve, match, pose, verify."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_accuracy, pose_covariance
from app.geometry.focal import search_camera
from app.geometry.pnp import PnpEstimate, estimate_pose_epnp_lm, estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.services.matches import Matches, QueryMatcher
from app.services.retrieval import Retrieval
from app.services.verification import (
    Evidence,
    Limits,
    Reason,
    confidence_of,
    coverage,
    gather_evidence,
    judge,
)
from app.services.vision_models import VisionModels
from app.storage.map_artifact import MapArtifact
from app.vision.images import Rgb, measure_quality, to_gray
from app.vision.index import GlobalIndex
from app.vision.local_features import LocalFeatureExtractor

# Two poses nearer than this, in both respects, are one place.
SAME_PLACE_M, SAME_PLACE_COSINE = 0.5, float(np.cos(np.radians(15)))
# A rival below this share of the best pose's features is not worth a closer look.
RIVAL_SHARE = 0.1
MIN_RIVAL_INLIERS = 8
# A first pose with this many times the inliers that are asked for, spread over this share of the image, gets no
# better by more keyframes (measured: docs/features.md).
CONVINCING_INLIERS, CONVINCING_COVERAGE = 5, 0.4


@dataclass(frozen=True, slots=True)
class LocalizerSettings:
    """How to localize. The defaults are the measured best (docs/features.md); `PAPER` is paper A's pipeline.

    `keyframes` are matched for their looks, then up to `other_places` more that look alike but show other
    places, then `covisible` ones that see what the first pose sees; up to `look_alikes` for each of the best two
    may prove that the place is not unique. A frame that is not located gets a second look at `second_look`
    keyframes, turned ones too. `max_error` is the inlier limit as an angle (tangent):
    pixels over focal length. Without `limits` those of the map's features hold.
    """

    keyframes: int = 10
    other_places: int = 4
    look_alikes: int = 6
    covisible: int = 10
    second_look: int = 40
    max_error: float = 6.0 / 525.0
    estimator: Literal["lo_ransac", "epnp_lm"] = "lo_ransac"
    fundamental_filter: bool = False
    limits: Limits | None = None


# Paper A, 2.3: the best keyframe alone, fundamental-matrix RANSAC, EPnP and Levenberg-Marquardt, no abstention
# beyond what the estimator needs.
PAPER = LocalizerSettings(
    keyframes=1,
    other_places=0,
    look_alikes=0,
    covisible=0,
    second_look=0,
    estimator="epnp_lm",
    fundamental_filter=True,
    limits=Limits.none(),
)


@dataclass(frozen=True, slots=True)
class KeyframeVote:
    """A keyframe that was matched, and how many of its matches agree with the pose."""

    keyframe: int
    matches: int
    inliers: int


@dataclass(frozen=True, slots=True)
class Localization:
    """The outcome for one frame. `world_from_camera` is None exactly when `reason` says why.

    `position_m`, `orientation_deg`: one sigma; `confidence`: probability that the error is below 0.5 m and 5
    degrees; `timings_ms` by stage.
    """

    world_from_camera: Pose | None
    reason: Reason | None
    evidence: Evidence
    position_m: float | None
    orientation_deg: float | None
    confidence: float
    keyframes: tuple[KeyframeVote, ...]
    camera: Camera | None
    timings_ms: dict[str, float]


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A pose and the matches that it was estimated from."""

    estimate: PnpEstimate
    matches: Matches

    @property
    def inliers(self) -> Matches:
        """The matches that agree with the pose."""
        return self.matches.take(self.estimate.inlier_mask)

    @property
    def rest(self) -> Matches:
        """The matches that don't."""
        return self.matches.take(~self.estimate.inlier_mask)


class Localizer:
    """Localizes frames in one map. Stateless between calls, safe to share between threads."""

    def __init__(
        self,
        artifact: MapArtifact,
        index: GlobalIndex,
        models: VisionModels,
        settings: LocalizerSettings | None = None,
    ) -> None:
        models.check_descriptor(artifact.metadata.descriptor_sha256)
        self.artifact = artifact
        self.index = index
        self._retrieval = Retrieval(artifact, index)
        self._descriptor = models.global_descriptor
        self._extractor = models.extractor(artifact.metadata.features)
        self._settings = settings or LocalizerSettings()
        self._limits = self._settings.limits or Limits(min_inliers=self._extractor.min_inliers)

    @property
    def retrieval(self) -> Retrieval:
        """Retrieval in this map."""
        return self._retrieval

    @property
    def extractor(self) -> LocalFeatureExtractor:
        """The extractor of the map's features."""
        return self._extractor

    def localize(
        self, rgb: Rgb, camera: Camera | None, allowed: NDArray[np.int64] | None = None
    ) -> Localization:
        """Localize an RGB image (height, width, 3) of a camera of that size; `allowed` restricts retrieval.

        Without a camera the focal length of a centred pinhole is searched for.
        """
        timer = StageTimer()
        gray = to_gray(rgb)
        query = QueryMatcher(gray, self.artifact, self._extractor, self._settings.fundamental_filter)
        descriptor = self._descriptor.describe(rgb)
        timer.lap("describe")
        settings = self._settings
        similar = self._retrieval.similar(descriptor, settings.keyframes, settings.other_places, allowed)
        timer.lap("retrieve")
        matches = query.match(similar)
        timer.lap("match")
        result = self._locate(query, matches, camera, rgb.shape[:2], allowed, timer)
        if settings.second_look and result.reason in ("no_match", "too_few_inliers") and query.feature_count:
            matches = query.match_all(self._wider(rgb, descriptor, allowed))
            timer.lap("match")
            again = self._locate(query, matches, camera, rgb.shape[:2], allowed, timer)
            result = again if again.world_from_camera is not None else result
        if result.reason == "no_match" and measure_quality(gray).is_poor:
            return replace(result, reason="poor_image")
        return result

    def _wider(
        self, rgb: Rgb, descriptor: NDArray[np.float32], allowed: NDArray[np.int64] | None
    ) -> list[int]:
        """Return keyframes for a second look: further down the ranks, and for the image turned by 90, 180 and
        270 degrees, since the global descriptor wants it upright and the phone may not say how it was held."""
        rows = self._retrieval.similar(descriptor, self._settings.second_look, 0, allowed)
        for turns in (1, 2, 3):
            turned = self._descriptor.describe(np.ascontiguousarray(np.rot90(rgb, turns)))
            rows += self._retrieval.similar(turned, self._settings.keyframes, 0, allowed)
        return rows

    def _locate(
        self,
        query: QueryMatcher,
        matches: Matches,
        camera: Camera | None,
        size: tuple[int, ...],
        allowed: NDArray[np.int64] | None,
        timer: StageTimer,
    ) -> Localization:
        camera = camera or self._search_camera(matches, size)
        if camera is None:
            timer.lap("pose")
            return _nothing("no_match", timer, matches.feature_count)
        best = self._hypothesis(query, matches, camera, allowed, timer)
        if best is None:
            return _nothing("no_match", timer, matches.feature_count, camera)
        rival = self._rival(query, best, camera, allowed, timer)
        if rival is not None and rival.inliers.feature_count > best.inliers.feature_count:
            best, rival = rival, best
        return self._conclude(best, rival, camera, timer)

    def _search_camera(self, matches: Matches, size: tuple[int, ...]) -> Camera | None:
        height, width = size
        return search_camera(
            matches.points_px,
            matches.points_in_world,
            width,
            height,
            self._settings.max_error,
            max(self._limits.min_inliers, 8),
        )

    def _hypothesis(
        self,
        query: QueryMatcher,
        matches: Matches,
        camera: Camera,
        allowed: NDArray[np.int64] | None,
        timer: StageTimer,
        rival: PnpEstimate | None = None,
    ) -> Hypothesis | None:
        """Return the pose that most matches agree on, or refine the one of a rival.

        Unless the first estimate is convincing it is made again, with the keyframes that must see the same by it:
        what retrieval missed is not lost. A rival always is, to be judged by all that speaks for it.
        """
        first = rival or self._estimate(matches, camera)
        timer.lap("pose")
        if first is None:
            return None
        found = Hypothesis(first, matches)
        if not self._settings.covisible or (rival is None and self._is_convincing(found, camera)):
            return found
        more = self._retrieval.covisible(
            first.world_from_camera, self._settings.covisible, query.matched, allowed
        )
        matches = Matches.merge([matches, query.match(more)])
        timer.lap("match")
        second = self._estimate(matches, camera, first.world_from_camera)
        timer.lap("pose")
        return None if second is None else Hypothesis(second, matches)

    def _is_convincing(self, found: Hypothesis, camera: Camera) -> bool:
        inliers = found.inliers
        enough = inliers.feature_count >= CONVINCING_INLIERS * self._limits.min_inliers
        return enough and coverage(inliers.points_px, (camera.width, camera.height)) >= CONVINCING_COVERAGE

    def _rival(
        self,
        query: QueryMatcher,
        best: Hypothesis,
        camera: Camera,
        allowed: NDArray[np.int64] | None,
        timer: StageTimer,
    ) -> Hypothesis | None:
        """Return the best other place that explains matches which the best pose doesn't, on equal terms.

        Places that look like the best keyframes are matched for it, whether retrieval found them or not.
        """
        if self._settings.look_alikes:
            twins = [
                twin
                for vote in _votes(best.matches, best.inliers)[:2]
                for twin in self._retrieval.look_alikes(vote.keyframe, self._settings.look_alikes)
            ]
            if allowed is not None:
                twins = [twin for twin in twins if twin in set(allowed.tolist())]
            rest = Matches.merge([best.rest, query.match(twins)])
            timer.lap("match")
        else:
            rest = best.rest
        needed = max(MIN_RIVAL_INLIERS, RIVAL_SHARE * best.inliers.feature_count)
        if self._limits.max_rival_share >= 1.0 or len(rest) < needed:
            return None
        # A rival that matters holds a third of what is left or more: 300 samples of three find it.
        first = self._estimate(rest, camera, max_iterations=300)
        if first is None or _same_place(first, best.estimate):
            return None
        if rest.take(first.inlier_mask).feature_count < needed:
            return None
        rival = self._hypothesis(query, rest, camera, allowed, timer, first)
        return None if rival is None or _same_place(rival.estimate, best.estimate) else rival

    def _estimate(
        self, matches: Matches, camera: Camera, prior: Pose | None = None, max_iterations: int = 5000
    ) -> PnpEstimate | None:
        limit_px = self._settings.max_error * camera.focal_px
        if self._settings.estimator == "epnp_lm":
            return estimate_pose_epnp_lm(
                matches.points_px, matches.points_in_world, camera, max_error_px=limit_px
            )
        return estimate_pose_lo_ransac(
            matches.points_px,
            matches.points_in_world,
            camera,
            max_error_px=limit_px,
            max_iterations=max_iterations,
            prior=prior,
        )

    def _conclude(
        self, best: Hypothesis, rival: Hypothesis | None, camera: Camera, timer: StageTimer
    ) -> Localization:
        pose, inliers = best.estimate.world_from_camera, best.inliers
        evidence = gather_evidence(
            best.matches.query_rows,
            inliers.query_rows,
            inliers.points_px,
            np.zeros(0, np.intp) if rival is None else rival.inliers.query_rows,
            (camera.width, camera.height),
            self._retrieval.distance_m(pose),
        )
        centres = self.artifact.arrays.positions[inliers.keyframes]
        position_m, orientation_deg = _accuracy(inliers, centres, camera, pose)
        # What all points share, the map's own error, is not in the covariance.
        position_m = float(np.hypot(position_m, self.artifact.metadata.position_sigma_m))
        orientation_deg = float(np.hypot(orientation_deg, self.artifact.metadata.orientation_sigma_deg))
        reason = judge(evidence, position_m, self._limits)
        votes = _votes(best.matches, inliers)
        timer.lap("pose")
        if reason is not None:
            return Localization(None, reason, evidence, None, None, 0.0, votes, camera, timer.milliseconds)
        confidence = confidence_of(evidence)
        return Localization(
            pose, None, evidence, position_m, orientation_deg, confidence, votes, camera, timer.milliseconds
        )


class StageTimer:
    """Milliseconds by stage; laps of one stage add up."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.perf_counter()
        self.milliseconds[stage] = self.milliseconds.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now


def _same_place(a: PnpEstimate, b: PnpEstimate) -> bool:
    one, other = a.world_from_camera, b.world_from_camera
    apart_m = float(np.linalg.norm(one.translation - other.translation))
    return apart_m < SAME_PLACE_M and float(one.rotation[:, 2] @ other.rotation[:, 2]) > SAME_PLACE_COSINE


def _accuracy(
    inliers: Matches, keyframe_centres: NDArray[np.float64], camera: Camera, pose: Pose
) -> tuple[float, float]:
    """Return one sigma of position in metres and orientation in degrees.

    A point is uncertain along its keyframe's ray, which a camera beside the keyframe hardly sees: what counts is
    the part of it across the camera's own ray.
    """
    across = inliers.sigma_m * _sines(
        inliers.points_in_world - keyframe_centres, inliers.points_in_world - pose.translation
    )
    try:
        covariance = pose_covariance(
            inliers.points_px, inliers.points_in_world, camera, pose, point_sigma_m=across
        )
    except DegenerateGeometryError:
        return float("inf"), 180.0
    return pose_accuracy(covariance)


def _sines(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sine of the angle between each pair of vectors (n, 3), (n, 3)."""
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.linalg.norm(np.cross(a, b), axis=1) / np.maximum(lengths, 1e-12))


def _votes(matches: Matches, inliers: Matches) -> tuple[KeyframeVote, ...]:
    ids, counts = np.unique(matches.keyframes, return_counts=True)
    agreed = {int(i): int(n) for i, n in zip(*np.unique(inliers.keyframes, return_counts=True), strict=True)}
    votes = [KeyframeVote(int(i), int(n), agreed.get(int(i), 0)) for i, n in zip(ids, counts, strict=True)]
    return tuple(sorted(votes, key=lambda vote: -vote.inliers))


def _nothing(
    reason: Reason, timer: StageTimer, matches: int = 0, camera: Camera | None = None
) -> Localization:
    return Localization(None, reason, Evidence.none(matches), None, None, 0.0, (), camera, timer.milliseconds)
