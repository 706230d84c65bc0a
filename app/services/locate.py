"""Locate: from an uploaded image to a pose in the world and a point on the plan."""

from __future__ import annotations

import time
from dataclasses import replace

from app.engine.floors.floor import Floor
from app.engine.query.camera_sources import QueryCamera, query_camera
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.narrowing import AreaOnFloor, allowed_keyframes
from app.engine.query.upright import localize_upright
from app.engine.query.vdm.localizer import VdmLocalizer, VdmLocalizers
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.services.anchor_locator import AnchorLocator
from app.services.feature_library import FeatureLibrary
from app.services.locate_result import (
    LocateRequest,
    LocateResult,
    anchor_result,
    map_result,
    no_map_result,
)
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.floors import get_floor, list_floors
from app.storage.venues import list_venues
from app.vision.images import Rgb, decode_image


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
        self._library = library
        self._features = features
        self._vdm = VdmLocalizers(resources.models)
        self._anchors = anchors

    def locate(self, request: LocateRequest) -> LocateResult:
        """Answer a query.

        Raises `NotFoundError` for an unknown venue, floor or area, `InvalidImageError`, `InvalidCameraError` and
        `InvalidInputError` for a request that can't be answered.
        """
        started = time.perf_counter()
        method = "vdm" if request.method == "vdm" else "rgbd"
        venue = self._venue(request.venue)
        floors = self._floors(venue, request.floor)
        areas = self._areas(floors, request)
        rgb = decode_image(request.image, self._resources.settings.max_image_pixels)
        decoded_ms = 1e3 * (time.perf_counter() - started)
        camera = query_camera(request.camera, rgb, request.image)
        known = camera.camera if isinstance(camera.camera, Camera) else None
        if request.method == "anchor":
            return self._by_anchor(venue, rgb, known, request, floors, decoded_ms)
        serving = self._library.active(venue)
        if serving is None:
            if request.method == "auto" and known is not None:
                return self._by_anchor(venue, rgb, known, request, floors, decoded_ms)
            timings = {"decode": decoded_ms, "total": 1e3 * (time.perf_counter() - started)}
            return no_map_result(venue, method, camera, request, timings)
        version = serving[1]
        localizer = self._vdm.of(serving[0]) if request.method == "vdm" else serving[0]
        found, narrowed = self._search(localizer, rgb, camera, request, floors, areas)
        result = self._described(map_result(venue, version, found, floors, request, camera, narrowed))
        result.timings_ms.update(decode=decoded_ms, total=1e3 * (time.perf_counter() - started))
        if result.reason is not None and request.method == "auto" and known is not None:
            other = self._by_anchor(venue, rgb, known, request, floors, decoded_ms)
            return other if other.reason is None else result
        return result

    def _by_anchor(
        self,
        venue: str,
        rgb: Rgb,
        camera: Camera | None,
        request: LocateRequest,
        floors: list[Floor],
        decoded_ms: float,
    ) -> LocateResult:
        """Answer from what the venue's monitoring cameras see."""
        if camera is None:
            raise InvalidInputError("method anchor needs the phone's intrinsics: send the field camera.")
        found = self._anchors.locate(venue, request.floor, rgb, camera, request.gravity)
        result = self._described(anchor_result(venue, found, floors, camera))
        result.timings_ms.update(decode=decoded_ms, total=decoded_ms + sum(found.timings_ms.values()))
        return result

    def _venue(self, venue: str | None) -> str:
        if venue is not None:
            return venue
        with self._resources.database.read() as connection:
            venues = list_venues(connection)
        if len(venues) != 1:
            raise InvalidInputError(
                f"There are {len(venues)} venues: say in the field venue which one the image is from."
            )
        return venues[0].id

    def _floors(self, venue: str, floor: str | None) -> list[Floor]:
        with self._resources.database.read() as connection:
            if floor is not None:
                get_floor(connection, venue, floor)
            return list_floors(connection, venue)

    def _areas(self, floors: list[Floor], request: LocateRequest) -> list[AreaOnFloor] | None:
        """Return the areas that the request names, on its floor if it names one."""
        if request.area is None:
            return None
        own = [floor for floor in floors if request.floor in (None, floor.id)]
        return self._features.areas(own, request.area)

    def _described(self, result: LocateResult) -> LocateResult:
        """Return a result whose plan point says its area and nearest landmark."""
        if result.plan is None or result.floor is None:
            return result
        return replace(result, plan=self._features.described(result.plan, result.floor))

    def _search(
        self,
        localizer: Localizer | VdmLocalizer,
        rgb: Rgb,
        camera: QueryCamera,
        request: LocateRequest,
        floors: list[Floor],
        areas: list[AreaOnFloor] | None,
    ) -> tuple[Localization, bool]:
        """Search where floor, area and prior say; where that finds nothing, everywhere."""
        floor = next((floor for floor in floors if floor.id == request.floor), None)
        positions = localizer.artifact.arrays.positions
        allowed = allowed_keyframes(positions, floor, areas, request.prior)
        if allowed is not None and len(allowed):
            found = localize_upright(localizer, rgb, camera.camera, request.gravity, allowed)
            if found.world_from_camera is not None:
                return found, True
        return localize_upright(localizer, rgb, camera.camera, request.gravity), False
