"""The localization pipeline on one map: describe, retrieve, match, pose, verify."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_accuracy, pose_covariance
from app.geometry.epipolar import filter_by_fundamental_matrix
from app.geometry.focal import search_camera
from app.geometry.pnp import PnpEstimate, estimate_pose_epnp_lm, estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.services.verification import Evidence, Limits, Reason, confidence_of, gather_evidence, judge
from app.services.vision_models import VisionModels
from app.storage.map_artifact import MapArtifact
from app.vision.images import Rgb, measure_quality, to_gray
from app.vision.index import GlobalIndex
from app.vision.local_features import LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors

# Keyframes further from the pose than this, or looking elsewhere, share nothing with the query.
COVISIBLE_RADIUS_M = 5.0
COVISIBLE_COSINE = 0.5


@dataclass(frozen=True, slots=True)
class LocalizerSettings:
    """How to localize. The defaults are the measured best (docs/features.md); `PAPER` is paper A's pipeline.

    `max_error` is the inlier limit as an angle (tangent): pixels over focal length.
    """

    keyframes: int = 10
    covisible: int = 10
    max_error: float = 6.0 / 525.0
    estimator: Literal["lo_ransac", "epnp_lm"] = "lo_ransac"
    fundamental_filter: bool = False
    limits: Limits = Limits()


# Paper A, 2.3: the best keyframe alone, fundamental-matrix RANSAC, EPnP and Levenberg-Marquardt, no abstention
# beyond what the estimator needs.
PAPER = LocalizerSettings(
    keyframes=1, covisible=0, estimator="epnp_lm", fundamental_filter=True, limits=Limits.none()
)


@dataclass(frozen=True, slots=True)
class Matches:
    """Matches of one query with several keyframes, merged: pixels (n, 2), points (n, 3), their sigma (n,), rows
    of the query's features (n,), and keyframes (n,)."""

    points_px: NDArray[np.float64]
    points_in_world: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    query_rows: NDArray[np.intp]
    keyframes: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.points_px)

    def take(self, mask: NDArray[np.bool_]) -> Matches:
        """Return the matches that the mask (n,) marks."""
        return Matches(
            self.points_px[mask],
            self.points_in_world[mask],
            self.sigma_m[mask],
            self.query_rows[mask],
            self.keyframes[mask],
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
        self._descriptor = models.global_descriptor
        self._extractor = models.extractor(artifact.metadata.features)
        self._settings = settings or LocalizerSettings()
        self._axes = np.stack([artifact.pose(i).rotation[:, 2] for i in range(artifact.keyframe_count)])

    def localize(
        self, rgb: Rgb, camera: Camera | None, allowed: NDArray[np.int64] | None = None
    ) -> Localization:
        """Localize an RGB image (height, width, 3) of a camera of that size; `allowed` restricts retrieval.

        Without a camera the focal length of a centred pinhole is searched for.
        """
        timer = StageTimer()
        gray = to_gray(rgb)
        features = self._extractor.extract(gray)
        descriptor = self._descriptor.describe(rgb)
        timer.lap("describe")
        retrieved, _ = self.index.search(descriptor, self._settings.keyframes, allowed)
        timer.lap("retrieve")
        if len(features) < 8 and measure_quality(gray).is_poor:
            return _nothing("poor_image", timer)
        unit = to_unit_vectors(features.descriptors, self._extractor.binary)
        matches = self._match_all(features, unit, [int(i) for i in retrieved])
        timer.lap("match")
        camera = camera or self._search_camera(matches, rgb)
        if camera is None:
            return _nothing("no_match", timer, len(np.unique(matches.query_rows)))
        estimate = self._estimate(matches, camera)
        timer.lap("pose")
        if estimate is not None and self._settings.covisible:
            more = self._covisible(estimate.world_from_camera, set(retrieved.tolist()), allowed)
            matches = _merge([matches, self._match_all(features, unit, more)])
            timer.lap("match")
            estimate = self._estimate(matches, camera, estimate.world_from_camera)
        result = self._conclude(matches, estimate, camera, timer)
        if result.reason == "no_match" and measure_quality(gray).is_poor:
            return _nothing("poor_image", timer)
        return result

    def _search_camera(self, matches: Matches, rgb: Rgb) -> Camera | None:
        height, width = rgb.shape[:2]
        return search_camera(
            matches.points_px,
            matches.points_in_world,
            width,
            height,
            self._settings.max_error,
            max(self._settings.limits.min_inliers, 8),
        )

    def _match_all(
        self, features: LocalFeatures, unit: NDArray[np.float32], keyframes: Sequence[int]
    ) -> Matches:
        return _merge([self._match(features, unit, keyframe) for keyframe in keyframes])

    def _match(self, features: LocalFeatures, unit: NDArray[np.float32], keyframe: int) -> Matches:
        arrays, rows = self.artifact.arrays, self.artifact.rows(keyframe)
        theirs = to_unit_vectors(arrays.descriptors[rows], self._extractor.binary)
        a, b, _ = match_unit_vectors(unit, theirs, self._extractor.ratio, self._extractor.binary)
        if self._settings.fundamental_filter:
            good = filter_by_fundamental_matrix(
                features.keypoints_px[a], arrays.keypoints_px[rows][b], estimator="ransac"
            )
            a, b = a[good], b[good]
        return Matches(
            features.keypoints_px[a].astype(np.float64),
            arrays.points_in_world[rows][b].astype(np.float64),
            arrays.point_sigma_m[rows][b].astype(np.float64),
            a,
            np.full(len(a), keyframe, dtype=np.intp),
        )

    def _covisible(
        self, world_from_camera: Pose, known: set[int], allowed: NDArray[np.int64] | None
    ) -> list[int]:
        """Return further keyframes that see what the pose sees, nearest first."""
        distances = np.linalg.norm(self.artifact.arrays.positions - world_from_camera.translation, axis=1)
        cosines = self._axes @ world_from_camera.rotation[:, 2]
        cost = distances + 2.0 * (1.0 - cosines)
        cost[(distances > COVISIBLE_RADIUS_M) | (cosines < COVISIBLE_COSINE)] = np.inf
        cost[list(known)] = np.inf
        if allowed is not None:
            outside = np.ones(len(cost), dtype=bool)
            outside[allowed] = False
            cost[outside] = np.inf
        order = np.argsort(cost)[: self._settings.covisible]
        return [int(i) for i in order if np.isfinite(cost[i])]

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
        self, matches: Matches, estimate: PnpEstimate | None, camera: Camera, timer: StageTimer
    ) -> Localization:
        if estimate is None:
            timer.lap("pose")
            return _nothing("no_match", timer, len(np.unique(matches.query_rows)), camera)
        inliers = matches.take(estimate.inlier_mask)
        rival = self._rival(matches, estimate, camera)
        evidence = gather_evidence(
            matches.query_rows,
            inliers.query_rows,
            inliers.points_px,
            rival,
            (camera.width, camera.height),
            self._distance_to_keyframes(estimate.world_from_camera),
        )
        position_m, orientation_deg = _accuracy(inliers, camera, estimate.world_from_camera)
        reason = judge(evidence, position_m, self._settings.limits)
        votes = _votes(matches, inliers)
        timer.lap("pose")
        if reason is not None:
            return Localization(None, reason, evidence, None, None, 0.0, votes, camera, timer.milliseconds)
        return Localization(
            estimate.world_from_camera,
            None,
            evidence,
            position_m,
            orientation_deg,
            confidence_of(evidence),
            votes,
            camera,
            timer.milliseconds,
        )

    def _rival(self, matches: Matches, best: PnpEstimate, camera: Camera) -> int:
        """Return how many query features support another, distinct pose: a look-alike place."""
        rest = matches.take(~best.inlier_mask)
        needed = self._settings.limits.min_inliers
        if len(rest) < needed or self._settings.limits.max_rival_share >= 1.0:
            return 0
        # A rival that matters holds a third of what is left or more: 300 samples of three find it.
        other = self._estimate(rest, camera, max_iterations=300)
        if other is None:
            return 0
        apart = np.linalg.norm(other.world_from_camera.translation - best.world_from_camera.translation)
        cosine = float(other.world_from_camera.rotation[:, 2] @ best.world_from_camera.rotation[:, 2])
        if apart < 0.5 and cosine > np.cos(np.radians(15)):
            return 0
        return len(np.unique(rest.query_rows[other.inlier_mask]))

    def _distance_to_keyframes(self, world_from_camera: Pose) -> float:
        offsets = self.artifact.arrays.positions - world_from_camera.translation
        return float(np.sqrt((offsets**2).sum(axis=1).min()))


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


def _merge(parts: Sequence[Matches]) -> Matches:
    if not parts:
        return Matches(
            np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.intp), np.zeros(0, np.intp)
        )
    return Matches(
        np.concatenate([part.points_px for part in parts]),
        np.concatenate([part.points_in_world for part in parts]),
        np.concatenate([part.sigma_m for part in parts]),
        np.concatenate([part.query_rows for part in parts]),
        np.concatenate([part.keyframes for part in parts]),
    )


def _accuracy(inliers: Matches, camera: Camera, pose: Pose) -> tuple[float, float]:
    try:
        covariance = pose_covariance(
            inliers.points_px, inliers.points_in_world, camera, pose, point_sigma_m=inliers.sigma_m
        )
    except DegenerateGeometryError:
        return float("inf"), 180.0
    return pose_accuracy(covariance)


def _votes(matches: Matches, inliers: Matches) -> tuple[KeyframeVote, ...]:
    ids, counts = np.unique(matches.keyframes, return_counts=True)
    agreed = {int(i): int(n) for i, n in zip(*np.unique(inliers.keyframes, return_counts=True), strict=True)}
    votes = [KeyframeVote(int(i), int(n), agreed.get(int(i), 0)) for i, n in zip(ids, counts, strict=True)]
    return tuple(sorted(votes, key=lambda vote: -vote.inliers))


def _nothing(
    reason: Reason, timer: StageTimer, matches: int = 0, camera: Camera | None = None
) -> Localization:
    return Localization(None, reason, Evidence.none(matches), None, None, 0.0, (), camera, timer.milliseconds)
