"""The localization pipeline on one map: describe, retrieve, match, pose, verify."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.maps.vision_models import VisionModels
from app.engine.query.attempt.attempt import attempt
from app.engine.query.attempt.pose import PoseSearch
from app.engine.query.attempt.second_attempt import second_attempt, voted_by
from app.engine.query.attempt.second_look import second_look
from app.engine.query.hints import picture_hints
from app.engine.query.localization import Localization, same_place
from app.engine.query.matches import QueryMatcher
from app.engine.query.query import Query
from app.engine.query.settings import LocalizerSettings
from app.engine.query.verification import Limits
from app.engine.stage_timer import clock_s
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera
from app.vision.images import Rgb, measure_quality
from app.vision.index import GlobalIndex

# A frame that failed for these reasons gets another attempt.
UNSURE = ("no_match", "too_few_inliers")


class Localizer:
    """Localizes frames in one map. Stateless between calls, safe to share between threads."""

    def __init__(self, opened: OpenMap, settings: LocalizerSettings | None = None) -> None:
        self.map = opened
        self.settings = settings or LocalizerSettings()
        self.limits = self.settings.limits or Limits(min_inliers=opened.extractor.min_inliers)
        self.search = PoseSearch(opened, self.settings, self.limits)

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

    def matcher_of(self, query: Query) -> QueryMatcher:
        """Return what matches a query with this map."""
        return QueryMatcher(query, self.map, fundamental_filter=self.settings.fundamental_filter)

    def answer(self, query: Query, matcher: QueryMatcher | None = None) -> Localization:
        """Localize a query: a first attempt, and where that finds nothing a second and a third, wider ones.

        A `matcher` of the query that is given holds the keyframes that were matched afterwards.
        """
        matcher = matcher or self.matcher_of(query)
        opened, settings = self.map, self.settings
        started = clock_s()
        descriptor = opened.descriptor.describe(query.rgb)
        described = clock_s()
        similar = opened.retrieval.similar(
            descriptor, settings.keyframes, settings.other_places, query.allowed
        )
        query.spent_s["describe"] += described - started
        query.spent_s["retrieve"] += clock_s() - described
        result = attempt(self.search, matcher, matcher.match(similar))
        if (
            settings.second_attempt
            and result.reason in UNSURE
            and matcher.feature_count >= self.limits.min_inliers
        ):
            voted = voted_by(matcher, opened, settings.keyframes)
            result = _later(result, second_attempt(self.search, matcher, descriptor, voted))
            similar = list(dict.fromkeys([*voted[: settings.voted], *similar]))
        if settings.second_attempt and result.reason in UNSURE and opened.faint_extractor is not None:
            result = _later(result, self._third_attempt(query, [*similar, *matcher.matched]))
        if (
            settings.second_look
            and result.reason in (*UNSURE, "ambiguous")
            and opened.second_look is not None
        ):
            result = _later(result, second_look(self.search, matcher, opened.second_look, similar))
        if result.world_from_camera is None:
            result = replace(result, hints=(*picture_hints(query.gray, matcher.feature_count), *result.hints))
        if result.reason == "no_match" and measure_quality(query.gray).is_poor:
            return replace(result, reason="poor_image")
        return result

    def _third_attempt(self, query: Query, keyframes: list[int]) -> Localization:
        """Localize with the features of a faint image, among keyframes that were matched before."""
        faint = QueryMatcher(
            query, self.map, self.map.faint_extractor, fundamental_filter=self.settings.fundamental_filter
        )
        return attempt(self.search, faint, faint.match(keyframes))


def _later(first: Localization, second: Localization) -> Localization:
    """Return the later attempt's result if it found the place, else the first one's with its reason.

    Where the first one disputes the stated camera, a later one of the same place that merely does not is no answer.
    """
    if second.world_from_camera is None:
        return first
    is_disputed = first.camera_trust == "disputed" and second.camera_trust != "refined"
    if is_disputed and first.candidate is not None and same_place(first.candidate, second.world_from_camera):
        return first
    return second
