"""The localization pipeline on one map: describe, retrieve, match, pose, verify."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap, SecondLook
from app.engine.maps.vision_models import VisionModels
from app.engine.query.accuracy import accuracy_in_map, with_map_error
from app.engine.query.camera import fit_query_camera, lens_of_query
from app.engine.query.contradiction import contradicted_in_map
from app.engine.query.hints import picture_hints, view_hints
from app.engine.query.hypothesis import Hypothesis
from app.engine.query.intrinsics import CheckedCamera, check_intrinsics
from app.engine.query.localization import Localization, same_place, votes_of
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.placed import Accuracy
from app.engine.query.pose import pose_in_map
from app.engine.query.query import Query
from app.engine.query.second.agreement import Agreement
from app.engine.query.second.look import OPTIONS as SECOND_LOOK
from app.engine.query.second.look import SecondMatcher
from app.engine.query.settings import LocalizerSettings
from app.engine.query.verification import (
    Evidence,
    Limits,
    Reason,
    confidence_of,
    coverage,
    evidence_of,
    judge,
)
from app.engine.stage_timer import clock_s
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera, find_camera, focal_sigma_of
from app.geometry.lens import Lens
from app.geometry.pnp import PnpEstimate, estimate_pose_epnp_lm
from app.geometry.se3 import Pose
from app.vision.images import Rgb, measure_quality
from app.vision.index import GlobalIndex

Matcher = QueryMatcher | SecondMatcher

# A frame that failed for these reasons gets another attempt.
UNSURE = ("no_match", "too_few_inliers")


class Localizer:
    """Localizes frames in one map. Stateless between calls, safe to share between threads."""

    def __init__(self, opened: OpenMap, settings: LocalizerSettings | None = None) -> None:
        self.map = opened
        self.settings = settings or LocalizerSettings()
        self.limits = self.settings.limits or Limits(min_inliers=opened.extractor.min_inliers)

    @staticmethod
    def of(
        artifact: MapArtifact,
        index: GlobalIndex,
        models: VisionModels,
        settings: LocalizerSettings | None = None,
    ) -> Localizer:
        """Return the localizer of a map that is not open yet (`OpenMap.of`)."""
        return Localizer(OpenMap.of(artifact, index, models), settings)

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
        return self.answer(Query.of(rgb, camera, allowed, upright))

    def answer(self, query: Query) -> Localization:
        """Localize a query: a first attempt, and where that finds nothing a second and a third, wider ones."""
        return self.answer_by(self.matcher_of(query))

    def matcher_of(self, query: Query) -> QueryMatcher:
        """Return what matches a query with this map."""
        return QueryMatcher(query, self.map, fundamental_filter=self.settings.fundamental_filter)

    def answer_by(self, matcher: QueryMatcher) -> Localization:
        """Localize the query of a matcher, which then holds the keyframes that were matched for it."""
        opened, settings, query = self.map, self.settings, matcher.query
        started = clock_s()
        descriptor = opened.descriptor.describe(query.rgb)
        described = clock_s()
        similar = opened.retrieval.similar(
            descriptor, settings.keyframes, settings.other_places, query.allowed
        )
        query.spent_s["describe"] += described - started
        query.spent_s["retrieve"] += clock_s() - described
        result = self.attempt(matcher, matcher.match(similar))
        if (
            settings.second_attempt
            and result.reason in UNSURE
            and matcher.feature_count >= self.limits.min_inliers
        ):
            result = _later(result, self._second_attempt(matcher, descriptor))
        if settings.second_attempt and result.reason in UNSURE and opened.faint_extractor is not None:
            result = _later(result, self._third_attempt(query, [*similar, *matcher.matched]))
        if (
            settings.second_look
            and result.reason in (*UNSURE, "ambiguous")
            and opened.second_look is not None
        ):
            result = _later(result, self._second_look(matcher, opened.second_look, similar))
        if result.world_from_camera is None:
            result = replace(result, hints=(*picture_hints(query.gray, matcher.feature_count), *result.hints))
        if result.reason == "no_match" and measure_quality(query.gray).is_poor:
            return replace(result, reason="poor_image")
        return result

    def _second_attempt(self, matcher: QueryMatcher, descriptor: NDArray[np.float32]) -> Localization:
        """Localize with keyframes further down the ranks, and with those for the image turned by 90, 180 and 270
        degrees, since the global descriptor wants it upright and the phone may not say how it was held."""
        query, retrieval = matcher.query, self.map.retrieval
        rows = retrieval.similar(descriptor, self.settings.second_attempt, 0, query.allowed)
        for turns in () if query.upright else (1, 2, 3):
            turned = self.map.descriptor.describe(np.ascontiguousarray(np.rot90(query.rgb, turns)))
            rows += retrieval.similar(turned, self.settings.keyframes, 0, query.allowed)
        return self.attempt(matcher, matcher.match_all(rows))

    def _third_attempt(self, query: Query, keyframes: list[int]) -> Localization:
        """Localize with the features of a faint image, among keyframes that were matched before."""
        faint = QueryMatcher(
            query, self.map, self.map.faint_extractor, fundamental_filter=self.settings.fundamental_filter
        )
        return self.attempt(faint, faint.match(keyframes))

    def _second_look(self, first: QueryMatcher, look: SecondLook, similar: Sequence[int]) -> Localization:
        """Localize with the map's second features, by limits of their own."""
        matcher = SecondMatcher(first.query, self.map, first, look)
        options = SECOND_LOOK
        settings = replace(
            self.settings,
            covisible=options.covisible,
            look_alikes=options.look_alikes,
            rival_support_ratio=options.max_rival_balance_ratio,
            limits=replace(
                self.limits,
                min_inliers=options.min_inliers,
                min_coverage=options.min_coverage,
                min_unrepeated_share=options.min_unrepeated_share,
                min_unrepeated_of_twin=0,
                max_contradicted_share_of_twin=1.0,
                min_agreeing_cells=options.min_agreeing_cells,
                max_disagreeing_share=options.max_disagreeing_share,
            ),
        )
        matches = matcher.match(similar[: options.keyframes])
        if matches.feature_count < options.min_matches:
            return _nothing(first.query, matches, None)
        return Localizer(self.map, settings).attempt(matcher, matches)

    def attempt(self, matcher: Matcher, matches: Matches) -> Localization:
        """Localize by these matches and those that a first pose leads to."""
        query, known = matcher.query, matcher.query.known
        camera = known if isinstance(known, Camera) else self.find_camera(matches, query)
        if camera is None:
            return _nothing(query, matches, None)
        lens = lens_of_query(self.map.artifact.metadata, known) if self.settings.fit_lens else None
        camera = camera if lens is None else lens.of(camera)
        best = self._hypothesis(matcher, matches, camera)
        if best is not None and (not isinstance(known, Camera) or (lens is not None and lens.is_guess)):
            camera, best = self._fit_camera(best, camera, known, lens)
        if best is None:
            return _nothing(query, matches, camera)
        checked = CheckedCamera(camera=camera, best=best)
        if isinstance(known, Camera) and self.settings.check_intrinsics:
            checked = check_intrinsics(best, camera, self.estimate, partial(self.find_camera, query=query))
            best, camera = checked.best, checked.camera
        rival = self._rival(matcher, best, camera)
        best, rival = self._ordered(matcher, best, rival, camera)
        sigmas = focal_sigma_of(known, camera), 0.0 if lens is None else lens.sigma
        return self._conclude(matcher, best, rival, checked, sigmas)

    def _fit_camera(
        self, best: Hypothesis, camera: Camera, known: Camera | ApproximateCamera | None, lens: Lens | None
    ) -> tuple[Camera, Hypothesis | None]:
        """Fit the camera to all inliers, and the pose again."""
        fitted = fit_query_camera(best.inliers, best.estimate, camera, known, lens)
        if fitted is None:
            return camera, None
        estimate = self.estimate(best.matches, fitted, best.pose)
        return fitted, None if estimate is None else Hypothesis.of(estimate, best.matches)

    def find_camera(self, matches: Matches, query: Query) -> Camera | None:
        """Return the pinhole of any focal length that most matches agree with, near the one that is known roughly."""
        near = query.known if isinstance(query.known, ApproximateCamera) else None
        points, threshold = (matches.points_px, matches.points_in_world), self.settings.max_error_tangent
        return find_camera(*points, *query.size_px, threshold, max(self.limits.min_inliers, 8), near)

    def _hypothesis(
        self, matcher: Matcher, matches: Matches, camera: Camera, rival: PnpEstimate | None = None
    ) -> Hypothesis | None:
        """Return the pose that most matches agree on, or refine the one of a rival.

        Unless the first estimate is convincing it is made again, with the keyframes that must see the same by it:
        what retrieval missed is not lost. A rival always is, to be judged by all that speaks for it.
        """
        query = matcher.query
        first = rival or self.estimate(matches, camera)
        if first is None:
            return None
        found = Hypothesis.of(first, matches)
        if not self.settings.covisible or (rival is None and self._is_convincing(found, camera)):
            return found
        more = self.map.retrieval.covisible(
            found.pose, self.settings.covisible, matcher.matched, query.allowed
        )
        matches = Matches.merge([matches, matcher.match(more)])
        second = self.estimate(matches, camera, found.pose)
        return None if second is None else Hypothesis.of(second, matches)

    def _is_convincing(self, found: Hypothesis, camera: Camera) -> bool:
        inliers, settings = found.inliers, self.settings
        enough = found.inlier_features >= settings.convincing_inliers_factor * self.limits.min_inliers
        size_px = camera.width, camera.height
        return enough and coverage(inliers.points_px, size_px) >= settings.convincing_coverage

    def _rival(self, matcher: Matcher, best: Hypothesis, camera: Camera) -> Hypothesis | None:
        """Return the best other place that explains matches which the best pose doesn't, on equal terms.

        Places that look like the best keyframes are matched for it, whether retrieval found them or not.
        """
        settings, rest = self.settings, best.rest
        if settings.look_alikes:
            voted = _best_two(best)
            twins = self.map.retrieval.look_alikes_of(voted, settings.look_alikes, matcher.query.allowed)
            rest = Matches.merge([rest, matcher.match(twins)])
        needed = max(settings.min_rival_inliers, settings.rival_ratio * best.inlier_features)
        if self.limits.max_rival_share >= 1.0 or len(rest) < needed:
            return None
        first = self.estimate(rest, camera, max_iterations=settings.rival_iterations)
        if first is None or same_place(first.world_from_camera, best.pose):
            return None
        if rest.take(first.inlier_mask).feature_count < needed:
            return None
        rival = self._hypothesis(matcher, rest, camera, first)
        return None if rival is None or same_place(rival.pose, best.pose) else rival

    def _ordered(
        self, matcher: Matcher, best: Hypothesis, rival: Hypothesis | None, camera: Camera
    ) -> tuple[Hypothesis, Hypothesis | None]:
        """Return the pose that more speaks for, and the other one where that is not much less."""
        if rival is None:
            return best, None
        own, other = (_support(matcher, each, camera) for each in (best, rival))
        if other > own:
            best, rival, own, other = rival, best, other, own
        return best, rival if other > self.settings.rival_support_ratio * own else None

    def estimate(
        self, matches: Matches, camera: Camera, prior: Pose | None = None, max_iterations: int | None = None
    ) -> PnpEstimate | None:
        """Return the pose of a camera that most matches agree on, None when too few do."""
        settings = self.settings
        if settings.estimator == "epnp_lm":
            threshold_px = settings.max_error_tangent * camera.focal_px
            return estimate_pose_epnp_lm(
                matches.points_px, matches.points_in_world, camera, max_error_px=threshold_px
            )
        iterations = settings.max_iterations if max_iterations is None else max_iterations
        return pose_in_map(self.map.artifact, matches, camera, settings.max_error_tangent, iterations, prior)

    def _conclude(
        self,
        matcher: Matcher,
        best: Hypothesis,
        rival: Hypothesis | None,
        checked: CheckedCamera,
        sigmas: tuple[float, float],
    ) -> Localization:
        """Return the outcome for the best pose: its accuracy, the evidence, and whether it can be trusted."""
        opened, query = self.map, matcher.query
        camera = checked.camera
        metadata = opened.artifact.metadata
        own = accuracy_in_map(opened.artifact, best.inliers, camera, best.pose, *sigmas)
        accuracy = with_map_error(own.with_more(checked.systematic), metadata)
        if checked.is_contradicted:
            own = own.with_more(checked.systematic)
        evidence, reason = self._judged(matcher, best, rival, camera, own, with_map_error(own, metadata))
        found = Localization(
            evidence=evidence,
            world_from_camera=best.pose,
            accuracy=accuracy,
            confidence=min(confidence_of(evidence), checked.max_confidence),
            keyframes=votes_of(best.matches, best.inliers),
            camera=camera,
            timings_ms=query.timings_ms,
            candidate=best.pose,
            is_refined=checked.is_refined,
            inliers=best.inliers,
        )
        if reason is None:
            return found
        hints = view_hints(reason, best.inliers.points_px, query.size_px)
        return replace(found.refused(reason), hints=hints)

    def _judged(
        self,
        matcher: Matcher,
        best: Hypothesis,
        rival: Hypothesis | None,
        camera: Camera,
        own: Accuracy,
        accuracy: Accuracy,
    ) -> tuple[Evidence, Reason | None]:
        """Return the evidence for the best pose, and why it can't be trusted, None if it can.

        `own` is the pose's accuracy by its inliers, `accuracy` with the map's error.
        """
        inliers, distance_m = best.inliers, self.map.retrieval.distance_m(best.pose)
        evidence = evidence_of(
            best.matches, inliers, camera, distance_m, None if rival is None else rival.inliers
        )
        unrepeated = matcher.unrepeated_count(inliers)
        similarity = self.map.retrieval.similarity_elsewhere(
            _best_two(best), self.settings.look_alikes, matcher.query.allowed
        )
        evidence = replace(
            evidence,
            position_sigma_m=own.position_m,
            unrepeated=unrepeated,
            similarity_elsewhere=similarity,
            agreement=_agreement(matcher, best, camera),
        )
        reason = judge(evidence, accuracy.position_m, self.limits)
        if reason is None:
            share = contradicted_in_map(
                self.map, best.pose, camera, matcher.features, inliers.points_px, matcher.query.allowed
            )
            evidence = replace(evidence, contradicted=share)
            reason = judge(evidence, accuracy.position_m, self.limits)
        return evidence, reason


def _best_two(found: Hypothesis) -> list[int]:
    """Return the two keyframes that agree most with a pose."""
    return [vote.keyframe for vote in votes_of(found.matches, found.inliers)[:2]]


def _agreement(matcher: Matcher, found: Hypothesis, camera: Camera) -> Agreement | None:
    """Return how far the picture of a second look agrees with a pose; None for a first one, which can't compare it."""
    return matcher.agreement(found.pose, camera) if isinstance(matcher, SecondMatcher) else None


def _support(matcher: Matcher, found: Hypothesis, camera: Camera) -> int:
    """Return how much speaks for a pose: cells that agree more than disagree, or inliers where none are compared."""
    agreement = _agreement(matcher, found, camera)
    return found.inlier_features if agreement is None else agreement.balance


def _later(first: Localization, second: Localization) -> Localization:
    """Return the later attempt's result if it found the place, else the first one's with its reason."""
    return second if second.world_from_camera is not None else first


def _nothing(query: Query, matches: Matches, camera: Camera | None) -> Localization:
    evidence = Evidence(matches=matches.feature_count)
    return Localization(
        evidence=evidence,
        reason="no_match",
        camera=camera,
        timings_ms=query.timings_ms,
        hints=view_hints("no_match", np.zeros((0, 2)), query.size_px),
    )
