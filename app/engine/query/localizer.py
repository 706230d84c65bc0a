"""The localization pipeline on one map: describe, retrieve, match, pose, verify."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.retrieval import Retrieval
from app.engine.maps.surroundings import MapSurroundings
from app.engine.maps.vision_models import VisionModels
from app.engine.query.accuracy import accuracy_in_map
from app.engine.query.camera import fit_query_camera, lens_of_query, scanned_camera
from app.engine.query.contradiction import KEYFRAMES, contradicted_share
from app.engine.query.localization import Localization, nothing_found, same_place, votes_of
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.pose import pose_in_map
from app.engine.query.verification import (
    Limits,
    confidence_of,
    coverage,
    evidence_of,
    judge,
)
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.focal import ApproximateCamera, find_camera, focal_sigma_of
from app.geometry.lens import Lens
from app.geometry.pnp import PnpEstimate, estimate_pose_epnp_lm
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatureExtractor
from app.vision.images import Rgb, measure_quality, to_gray
from app.vision.index import GlobalIndex

# A rival below this share of the best pose's features is not worth a closer look.
RIVAL_SHARE = 0.1
MIN_RIVAL_INLIERS = 8
# A first pose with this many times the inliers that are asked for, spread over this share of the image, gets no
# better by more keyframes (measured: docs/features.md).
CONVINCING_INLIERS, CONVINCING_COVERAGE = 5, 0.4


# A frame that failed for these reasons is looked at again.
UNSURE = ("no_match", "too_few_inliers")


@dataclass(frozen=True, slots=True)
class LocalizerSettings:
    """How to localize. The defaults are the measured best (docs/features.md); `PAPER` is paper A's pipeline.

    `keyframes` are matched for their looks, then up to `other_places` more that look alike but show other
    places, then `covisible` ones that see what the first pose sees; up to `look_alikes` for each of the best two
    may prove that the place is not unique. A frame that is not located gets a second look at `second_look`
    keyframes, turned ones too, and a third with the features of a faint image. `max_error` is the inlier limit as
    an angle (tangent): pixels over focal length. `fit_lens` fits the lens of a camera whose distortion isn't stated.
    Without `limits` those of the map's features hold.
    """

    keyframes: int = 10
    other_places: int = 4
    look_alikes: int = 6
    covisible: int = 10
    second_look: int = 40
    max_error: float = tangent_of_px(6.0)
    estimator: Literal["lo_ransac", "epnp_lm"] = "lo_ransac"
    fundamental_filter: bool = False
    fit_lens: bool = True
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
    fit_lens=False,
    limits=Limits.none(),
)


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
        self._surroundings = MapSurroundings(artifact)
        self._descriptor = models.global_descriptor
        self._extractor = models.extractor(artifact.metadata.features)
        self._settings = settings or LocalizerSettings()
        self._faint = self._extractor.for_faint_images()
        self._limits = self._settings.limits or Limits(min_inliers=self._extractor.min_inliers)

    @property
    def retrieval(self) -> Retrieval:
        """Retrieval in this map."""
        return self._retrieval

    @property
    def extractor(self) -> LocalFeatureExtractor:
        """The extractor of the map's features."""
        return self._extractor

    def scanned_camera(self, known: Camera) -> Camera:
        """Return a camera behind the lens that the map's scan showed, where it is the camera of the scan."""
        return scanned_camera(self.artifact.metadata, known)

    def similar(self, rgb: Rgb, count: int, allowed: NDArray[np.int64]) -> list[int]:
        """Return the `count` of the allowed keyframes that look most like an image (height, width, 3)."""
        return self._retrieval.similar(self._descriptor.describe(rgb), count, 0, allowed)

    def contradicted(
        self,
        features: tuple[NDArray[np.float64], NDArray[np.float32]],
        pose: Pose,
        camera: Camera,
        inliers_px: NDArray[np.float64],
        allowed: NDArray[np.int64] | None = None,
    ) -> float:
        """Return the share of a picture that speaks against a pose in this map (`contradicted_share`)."""
        keyframes = self._retrieval.covisible(pose, KEYFRAMES, set(), allowed)
        binary = self._extractor.binary
        return contradicted_share(self.artifact, keyframes, pose, camera, features, inliers_px, binary)

    def localize(
        self,
        rgb: Rgb,
        camera: Camera | ApproximateCamera | None,
        allowed: NDArray[np.int64] | None = None,
        upright: bool = False,
    ) -> Localization:
        """Localize an RGB image (height, width, 3) of a camera of that size; `allowed` restricts retrieval.

        Without a camera, or with an approximate one, the focal length of a centred pinhole is searched for.
        `upright` says that the image needs no turn.
        """
        timer = StageTimer()
        gray = to_gray(rgb)
        query = QueryMatcher(gray, self.artifact, self._extractor, self._settings.fundamental_filter, allowed)
        descriptor = self._descriptor.describe(rgb)
        timer.lap("describe")
        settings = self._settings
        similar = self._retrieval.similar(descriptor, settings.keyframes, settings.other_places, allowed)
        timer.lap("retrieve")
        matches = query.match(similar)
        timer.lap("match")
        size = rgb.shape[:2]
        result = self._locate(query, matches, camera, size, allowed, timer)
        if settings.second_look and result.reason in UNSURE and query.feature_count:
            matches = query.match_all(self._wider(rgb, descriptor, allowed, upright))
            timer.lap("match")
            result = self._better(result, self._locate(query, matches, camera, size, allowed, timer))
        if settings.second_look and result.reason in UNSURE and self._faint is not None:
            faint = QueryMatcher(gray, self.artifact, self._faint, settings.fundamental_filter, allowed)
            timer.lap("describe")
            matches = faint.match([*similar, *query.matched])
            timer.lap("match")
            result = self._better(result, self._locate(faint, matches, camera, size, allowed, timer))
        if result.reason == "no_match" and measure_quality(gray).is_poor:
            return replace(result, reason="poor_image")
        return result

    @staticmethod
    def _better(first: Localization, second: Localization) -> Localization:
        """Return the later look's result if it found the place, else the first look's with its reason."""
        return second if second.world_from_camera is not None else first

    def _wider(
        self, rgb: Rgb, descriptor: NDArray[np.float32], allowed: NDArray[np.int64] | None, upright: bool
    ) -> list[int]:
        """Return keyframes for a second look: further down the ranks, and for the image turned by 90, 180 and
        270 degrees, since the global descriptor wants it upright and the phone may not say how it was held."""
        rows = self._retrieval.similar(descriptor, self._settings.second_look, 0, allowed)
        for turns in () if upright else (1, 2, 3):
            turned = self._descriptor.describe(np.ascontiguousarray(np.rot90(rgb, turns)))
            rows += self._retrieval.similar(turned, self._settings.keyframes, 0, allowed)
        return rows

    def _locate(
        self,
        query: QueryMatcher,
        matches: Matches,
        known: Camera | ApproximateCamera | None,
        size: tuple[int, ...],
        allowed: NDArray[np.int64] | None,
        timer: StageTimer,
    ) -> Localization:
        camera = known if isinstance(known, Camera) else self._find_camera(matches, size, known)
        if camera is None:
            timer.lap("pose")
            return nothing_found("no_match", timer, matches.feature_count)
        lens = lens_of_query(self.artifact.metadata, known) if self._settings.fit_lens else None
        camera = camera if lens is None else lens.of(camera)
        best = self._hypothesis(query, matches, camera, allowed, timer)
        if best is not None and (not isinstance(known, Camera) or (lens is not None and lens.is_guess)):
            camera, best = self._fit_camera(best, camera, known, lens)
            timer.lap("pose")
        if best is None:
            return nothing_found("no_match", timer, matches.feature_count, camera)
        rival = self._rival(query, best, camera, allowed, timer)
        if rival is not None and rival.inliers.feature_count > best.inliers.feature_count:
            best, rival = rival, best
        sigmas = focal_sigma_of(known, camera), 0.0 if lens is None else lens.sigma
        return self._conclude(query, best, rival, camera, sigmas, allowed, timer)

    def _fit_camera(
        self, best: Hypothesis, camera: Camera, known: Camera | ApproximateCamera | None, lens: Lens | None
    ) -> tuple[Camera, Hypothesis | None]:
        """Fit the camera to all inliers, and the pose again."""
        fitted = fit_query_camera(best.inliers, best.estimate, camera, known, lens)
        if fitted is None:
            return camera, None
        estimate = self._estimate(best.matches, fitted, best.estimate.world_from_camera)
        return fitted, None if estimate is None else Hypothesis(estimate, best.matches)

    def _find_camera(
        self, matches: Matches, size: tuple[int, ...], near: ApproximateCamera | None
    ) -> Camera | None:
        points, limit = (matches.points_px, matches.points_in_world), self._settings.max_error
        return find_camera(*points, size[1], size[0], limit, max(self._limits.min_inliers, 8), near)

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
                for vote in votes_of(best.matches, best.inliers)[:2]
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
        if first is None or same_place(first.world_from_camera, best.estimate.world_from_camera):
            return None
        if rest.take(first.inlier_mask).feature_count < needed:
            return None
        rival = self._hypothesis(query, rest, camera, allowed, timer, first)
        if rival is None:
            return None
        same = same_place(rival.estimate.world_from_camera, best.estimate.world_from_camera)
        return None if same else rival

    def _estimate(
        self, matches: Matches, camera: Camera, prior: Pose | None = None, max_iterations: int = 5000
    ) -> PnpEstimate | None:
        limit = self._settings.max_error
        if self._settings.estimator == "epnp_lm":
            points = matches.points_px, matches.points_in_world
            return estimate_pose_epnp_lm(*points, camera, max_error_px=limit * camera.focal_px)
        return pose_in_map(self.artifact, matches, camera, limit, max_iterations, prior)

    def _conclude(
        self,
        query: QueryMatcher,
        best: Hypothesis,
        rival: Hypothesis | None,
        camera: Camera,
        sigmas: tuple[float, float],
        allowed: NDArray[np.int64] | None,
        timer: StageTimer,
    ) -> Localization:
        pose, inliers = best.estimate.world_from_camera, best.inliers
        against = None if rival is None else rival.inliers
        evidence = evidence_of(best.matches, inliers, camera, self._retrieval.distance_m(pose), against)
        centres = self.artifact.arrays.positions[inliers.keyframes]
        position_m, orientation_deg = accuracy_in_map(inliers, centres, camera, pose, *sigmas)
        unrepeated = query.unrepeated_count(inliers, self._surroundings)
        evidence = replace(evidence, position_sigma_m=position_m, unrepeated=unrepeated)
        # What all points share, the map's own error, is not in the covariance.
        position_m = float(np.hypot(position_m, self.artifact.metadata.position_sigma_m))
        orientation_deg = float(np.hypot(orientation_deg, self.artifact.metadata.orientation_sigma_deg))
        reason = judge(evidence, position_m, self._limits)
        if reason is None:
            share = self.contradicted(query.features, pose, camera, inliers.points_px, allowed)
            evidence = replace(evidence, contradicted=share)
            reason = judge(evidence, position_m, self._limits)
        votes = votes_of(best.matches, inliers)
        timer.lap("pose")
        found = Localization(
            pose,
            None,
            evidence,
            position_m,
            orientation_deg,
            confidence_of(evidence),
            votes,
            camera,
            timer.milliseconds,
            pose,
        )
        if reason is None:
            return found
        return replace(
            found,
            world_from_camera=None,
            reason=reason,
            position_m=None,
            orientation_deg=None,
            confidence=0.0,
        )
