"""Locate: from an uploaded image to a pose in the world and a point on the plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.earth import Earth
from app.engine.floors.floor import Floor
from app.engine.maps.open_map import OpenMap
from app.engine.query.camera_sources import QueryCamera, query_camera
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.narrowing import AreaOnFloor, allowed_keyframes
from app.engine.query.several.frame import GivenFrame
from app.engine.query.several.localize import localize_several
from app.engine.query.shown_matches import shown_matches
from app.engine.query.upright import localize_upright
from app.engine.query.vdm.localizer import VdmLocalizer
from app.engine.stage_timer import StageTimer
from app.errors import InvalidInputError, MapDamagedError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.services.anchor_locator import AnchorLocator
from app.services.floor_features import FeatureLibrary
from app.services.later_frames import decode_later
from app.services.localizers import localizer_on, vdm_localizer_on
from app.services.locate_result import (
    LocateRequest,
    LocateResult,
    anchor_result,
    map_result,
    on_earth,
)
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.floors import get_floor, list_floors
from app.storage.maps import MapVersion, active_version
from app.storage.venues import earth_of, list_venues
from app.vision.images import Rgb, decode_image


@dataclass(frozen=True, slots=True)
class _Place:
    """A venue as a query finds it: its floors, the map version that serves it and its place on Earth, if any."""

    venue: str
    floors: list[Floor]
    version: MapVersion | None
    earth: Earth | None


@dataclass(frozen=True, slots=True)
class _Pictures:
    """The picture that is to be placed, what is known of its camera, and the further frames of the query."""

    rgb: Rgb
    camera: QueryCamera
    later: tuple[GivenFrame, ...]


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
        self._anchors = anchors

    def locate(self, request: LocateRequest) -> LocateResult:
        """Answer a query.

        Raises `NotFoundError` for an unknown venue, floor or area, `InvalidImageError`, `InvalidCameraError` and
        `InvalidInputError` for a request that can't be answered.
        """
        timer = StageTimer()
        place = self._place(request)
        areas = self._areas(place.floors, request)
        rgb = decode_image(request.image, self._resources.settings.max_image_pixels)
        timer.lap("decode")
        camera = query_camera(request.camera, rgb, request.image)
        later = decode_later(request, rgb, self._resources.settings.max_image_pixels)
        if later:
            timer.lap("decode")
        known = camera.camera if isinstance(camera.camera, Camera) else None
        result = None
        if request.method != "anchor":
            result = self._by_map(place, _Pictures(rgb, camera, later), request, areas)
        if request.method == "anchor" or (request.method == "auto" and known is not None):
            result = self._by_anchor(place, rgb, known, request, result)
        assert result is not None  # noqa: S101 - one of the two was asked
        timings = {**result.timings_ms, **timer.milliseconds, "total": timer.total_ms}
        return replace(on_earth(self._described(result), place.earth), timings_ms=timings)

    def _by_map(
        self,
        place: _Place,
        pictures: _Pictures,
        request: LocateRequest,
        areas: list[AreaOnFloor] | None,
    ) -> LocateResult:
        """Answer from the venue's map."""
        if place.version is None:
            known = pictures.camera.likely
            return LocateResult(
                venue=place.venue,
                method="vdm" if request.method == "vdm" else "rgbd",
                map_version=None,
                reason="no_map",
                camera=known,
                camera_source=pictures.camera.source_of(known),
                gravity_checked=None if request.gravity is None else False,
            )
        try:
            return self._by_version(place, place.version, pictures, request, areas)
        except MapDamagedError:
            # Damage that the query itself came upon: the version before answers.
            return self._by_version(place, place.version, pictures, request, areas)

    def _by_version(
        self,
        place: _Place,
        active: MapVersion,
        pictures: _Pictures,
        request: LocateRequest,
        areas: list[AreaOnFloor] | None,
    ) -> LocateResult:
        """Answer from the version that serves in place of the active one, which is the active one unless damaged."""
        opened, version = self._library.serving(active)
        found, narrowed = self._search(place, opened, pictures, request, areas)
        result = map_result(place.venue, version, found, narrowed, place.floors, request, pictures.camera)
        if not request.show_matches or result.reason is not None or found.inliers is None:
            return result
        return replace(result, shown_matches=shown_matches(opened.artifact, found.inliers))

    def _by_anchor(
        self,
        place: _Place,
        rgb: Rgb,
        camera: Camera | None,
        request: LocateRequest,
        by_map: LocateResult | None,
    ) -> LocateResult:
        """Answer from what the venue's monitoring cameras see, where the map's answer says nothing."""
        if by_map is not None and by_map.reason is None:
            return by_map
        if camera is None:
            raise InvalidInputError("method anchor needs the phone's intrinsics: send the field camera.")
        found = self._anchors.locate(place.venue, request.floor, rgb, camera, request.gravity)
        result = anchor_result(place.venue, found, place.floors, camera)
        keep_map = by_map is not None and by_map.map_version is not None and result.reason is not None
        return by_map if keep_map and by_map is not None else result

    def _place(self, request: LocateRequest) -> _Place:
        with self._resources.database.read() as connection:
            venue = request.venue
            if venue is None:
                venues = list_venues(connection)
                if len(venues) != 1:
                    raise InvalidInputError(
                        f"There are {len(venues)} venues: say in the field venue which one the image is from."
                    )
                venue = venues[0].id
            if request.floor is not None:
                get_floor(connection, venue, request.floor)
            version = active_version(connection, venue)
            floors = list_floors(connection, venue)
            return _Place(venue, floors, version, earth_of(connection, venue, floors))

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
        place: _Place,
        opened: OpenMap,
        pictures: _Pictures,
        request: LocateRequest,
        areas: list[AreaOnFloor] | None,
    ) -> tuple[Localization, bool]:
        """Search where floor, area and prior say; where that finds nothing, everywhere."""
        localizer_of = vdm_localizer_on if request.method == "vdm" else localizer_on
        localizer = localizer_of(self._resources.settings, opened)
        floor = next((floor for floor in place.floors if floor.id == request.floor), None)
        allowed = allowed_keyframes(opened.artifact.arrays.positions, floor, areas, request.prior)
        if allowed is not None and len(allowed):
            found = _localize(localizer, pictures, request, allowed)
            if found.world_from_camera is not None:
                return found, True
        return _localize(localizer, pictures, request), False


def _localize(
    localizer: Localizer | VdmLocalizer,
    pictures: _Pictures,
    request: LocateRequest,
    allowed: NDArray[np.int64] | None = None,
) -> Localization:
    """Localize the picture, by further ones where there are any."""
    camera = pictures.camera.camera
    if not pictures.later:
        return localize_upright(localizer, pictures.rgb, camera, request.gravity, allowed)
    assert isinstance(localizer, Localizer)  # noqa: S101 - `decode_later` refuses other methods
    first = GivenFrame(
        rgb=pictures.rgb,
        camera=camera,
        first_from_camera=None if pictures.later[0].first_from_camera is None else Pose.identity(),
        gravity=request.gravity,
    )
    return localize_several(localizer, [first, *pictures.later], allowed)
