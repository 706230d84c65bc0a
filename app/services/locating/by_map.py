"""What the map of a venue says of a query."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.engine.query.camera_sources import QueryCamera
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.narrowing import allowed_keyframes
from app.engine.query.several.frame import GivenFrame
from app.engine.query.several.localize import localize_several
from app.engine.query.shown_matches import shown_matches
from app.engine.query.upright import localize_upright
from app.errors import MapDamagedError
from app.geometry.se3 import Pose
from app.services.localizers import localizer_on, vdm_localizer_on
from app.services.locate_result import LocateRequest, LocateResult, map_result
from app.services.locating.place import QueryPlace
from app.services.map_library import MapLibrary
from app.settings import Settings
from app.storage.maps import MapVersion
from app.vision.images import Rgb


@dataclass(frozen=True, slots=True)
class Pictures:
    """The picture that is to be placed, what is known of its camera, and the further frames of the query."""

    rgb: Rgb
    camera: QueryCamera
    later: tuple[GivenFrame, ...]


@dataclass(frozen=True, slots=True)
class MapAnswers:
    """Answers queries from the maps of venues."""

    library: MapLibrary
    settings: Settings

    def answer(self, place: QueryPlace, pictures: Pictures, request: LocateRequest) -> LocateResult:
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
            return self._by_version(place, place.version, pictures, request)
        except MapDamagedError:
            # Damage that the query itself came upon: the version before answers.
            return self._by_version(place, place.version, pictures, request)

    def _by_version(
        self, place: QueryPlace, active: MapVersion, pictures: Pictures, request: LocateRequest
    ) -> LocateResult:
        """Answer from the version that serves in place of the active one, which is the active one unless damaged.

        It is searched where floor, area and prior say; where that finds nothing, everywhere.
        """
        opened, version = self.library.serving(active)
        allowed = allowed_keyframes(opened.artifact.arrays.positions, place.floor, place.areas, request.prior)
        localizer = (vdm_localizer_on if request.method == "vdm" else localizer_on)(self.settings, opened)
        camera, gravity = pictures.camera.camera, request.gravity
        localize: Callable[[NDArray[np.int64] | None], Localization]
        if pictures.later:
            assert isinstance(localizer, Localizer)  # noqa: S101 - `decode_later` refuses other methods
            is_moved = pictures.later[0].first_from_camera is not None
            first = GivenFrame(
                rgb=pictures.rgb,
                camera=camera,
                first_from_camera=Pose.identity() if is_moved else None,
                gravity=gravity,
            )
            localize = partial(localize_several, localizer, [first, *pictures.later])
        else:
            localize = partial(localize_upright, localizer, pictures.rgb, camera, gravity)
        found, narrowed = None, False
        if allowed is not None and len(allowed):
            found = localize(allowed)
            narrowed = found.world_from_camera is not None
        if found is None or not narrowed:
            found = localize(None)
        result = map_result(place.venue, version, found, narrowed, place.floors, request, pictures.camera)
        if not request.show_matches or result.reason is not None or found.inliers is None:
            return result
        return replace(result, shown_matches=shown_matches(opened.artifact, found.inliers))
