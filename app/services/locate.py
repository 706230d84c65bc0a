"""Locate: from an uploaded image to a pose in the world and a point on the plan."""

from __future__ import annotations

from dataclasses import replace

from app.engine.query.camera_sources import query_camera
from app.engine.stage_timer import StageTimer
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.services.anchor_locator import AnchorLocator
from app.services.floor_features import FeatureLibrary
from app.services.locate_result import LocateRequest, LocateResult, Suspected, anchor_result, on_earth
from app.services.locating.by_map import MapAnswers, Pictures
from app.services.locating.later_frames import decode_later
from app.services.locating.place import QueryPlace, place_of
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.vision.images import Rgb, decode_photo


class LocateService:
    """Answers queries. Safe to share between threads."""

    def __init__(
        self,
        resources: Resources,
        library: MapLibrary,
        features: FeatureLibrary,
        anchors: AnchorLocator,
    ) -> None:
        self._resources = resources
        self._by_map = MapAnswers(library, resources.settings)
        self._features = features
        self._anchors = anchors

    def locate(self, request: LocateRequest) -> LocateResult:
        """Answer a query.

        Raises `NotFoundError` for an unknown venue, floor or area, `InvalidImageError`, `InvalidCameraError` and
        `InvalidInputError` for a request that can't be answered.
        """
        timer, max_pixels = StageTimer(), self._resources.settings.max_image_pixels
        place = place_of(self._resources.database, self._features, request)
        photo = decode_photo(request.image, max_pixels)
        timer.lap("decode")
        camera = query_camera(request.camera, photo.rgb, request.image, photo.quarter_turns)
        later = decode_later(request, photo.rgb, max_pixels) if request.later else ()
        if later:
            timer.lap("decode")
        known = camera.camera if isinstance(camera.camera, Camera) else None
        result = None
        if request.method != "anchor":
            result = self._by_map.answer(place, Pictures(photo.rgb, camera, later), request)
        is_open = result is None or result.reason is not None
        if request.method == "anchor" or (request.method == "auto" and known is not None and is_open):
            result = self._by_anchor(place, photo.rgb, known, request, result)
        assert result is not None  # noqa: S101 - one of the two was asked
        if result.plan is not None and result.floor is not None:
            result = replace(result, plan=self._features.described(result.plan, result.floor))
        result = replace(result, suspected=self._described(result.suspected))
        result = on_earth(result, place.earth)
        timings = {**result.timings_ms, **timer.milliseconds, "total": timer.total_ms}
        return replace(result, timings_ms=timings)

    def _described(self, suspected: Suspected | None) -> Suspected | None:
        if suspected is None or suspected.plan is None:
            return suspected
        return replace(suspected, plan=self._features.described(suspected.plan, suspected.floor))

    def _by_anchor(
        self,
        place: QueryPlace,
        rgb: Rgb,
        camera: Camera | None,
        request: LocateRequest,
        by_map: LocateResult | None,
    ) -> LocateResult:
        """Answer from what the venue's monitoring cameras see; with the map's answer where these say nothing."""
        if camera is None:
            raise InvalidInputError("method anchor needs the phone's intrinsics: send the field camera.")
        found = self._anchors.locate(place.venue, request.floor, rgb, camera, request.gravity)
        result = anchor_result(place.venue, found, place.floors, request, camera)
        keep_map = by_map is not None and by_map.map_version is not None and result.reason is not None
        return by_map if keep_map and by_map is not None else result
