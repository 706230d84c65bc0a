"""Locate: from an uploaded image to a pose in the world and a point on the plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Literal

from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera
from app.geometry.se3 import Pose
from app.geometry.turns import angle_to_down_deg
from app.services.camera_sources import CameraSource, QueryCamera, query_camera
from app.services.floor_features.library import FeatureLibrary
from app.services.floor_plans import PlanPoint, floor_of, plan_point
from app.services.localization import KeyframeVote, Localization
from app.services.localizer import Localizer
from app.services.map_library import MapLibrary
from app.services.narrowing import AreaOnFloor, Prior, allowed_keyframes
from app.services.resources import Resources
from app.services.upright import localize_upright
from app.services.vdm_localizer import VdmLocalizer, VdmLocalizers
from app.services.verification import Reason
from app.storage.floors import Floor, get_floor, list_floors
from app.storage.maps import MapVersion
from app.storage.venues import list_venues
from app.vision.images import Rgb, decode_image

Method = Literal["auto", "rgbd", "vdm", "anchor"]
# A phone that is held still knows down to a degree or two; moving it can add ten.
GRAVITY_LIMIT_DEG = 20.0


@dataclass(frozen=True, slots=True)
class LocateRequest:
    """A query. `camera` is a `Camera` (scaled when the image has another size), or the numbers of one for the
    image as it is; without it EXIF, a list of phones or a search tells the focal length. `gravity` is the direction
    of down in camera axes, `area` an area's id or name."""

    image: bytes
    venue: str | None = None
    floor: str | None = None
    camera: Camera | tuple[float, ...] | None = None
    gravity: tuple[float, float, float] | None = None
    prior: Prior | None = None
    method: Method = "auto"
    area: str | None = None


@dataclass(frozen=True, slots=True)
class LocateResult:
    """The answer: a pose, or a reason why there is none.

    `narrowed` says whether floor, area or prior held the search; `gravity_checked` whether the pose that was found
    was compared with the request's gravity, None when there was none.
    """

    venue: str
    method: str
    map_version: int | None
    reason: Reason | None
    world_from_camera: Pose | None = None
    floor: Floor | None = None
    plan: PlanPoint | None = None
    position_m: float | None = None
    orientation_deg: float | None = None
    confidence: float = 0.0
    inliers: int = 0
    matches: int = 0
    keyframes: tuple[KeyframeVote, ...] = ()
    camera: Camera | None = None
    camera_source: CameraSource = "unknown"
    narrowed: bool = False
    gravity_checked: bool | None = None
    timings_ms: dict[str, float] = field(default_factory=dict)


class LocateService:
    """Answers queries. Safe to share between threads."""

    def __init__(
        self, resources: Resources, library: MapLibrary, features: FeatureLibrary | None = None
    ) -> None:
        self._resources = resources
        self._library = library
        self._features = features or FeatureLibrary(resources.database)
        self._vdm = VdmLocalizers(resources.models)

    def locate(self, request: LocateRequest) -> LocateResult:
        """Answer a query.

        Raises `NotFoundError` for an unknown venue, floor or area, `InvalidImageError`, `InvalidCameraError` and
        `InvalidInputError` for a request that can't be answered.
        """
        started = time.perf_counter()
        if request.method == "anchor":
            raise InvalidInputError(f"method {request.method!r} is not available; use auto, rgbd or vdm.")
        method = "vdm" if request.method == "vdm" else "rgbd"
        venue = self._venue(request.venue)
        floors = self._floors(venue, request.floor)
        areas = self._areas(floors, request)
        rgb = decode_image(request.image, self._resources.settings.max_image_pixels)
        decoded_ms = 1e3 * (time.perf_counter() - started)
        camera = query_camera(request.camera, rgb, request.image)
        serving = self._library.active(venue)
        if serving is None:
            timings = {"decode": decoded_ms, "total": 1e3 * (time.perf_counter() - started)}
            return _no_map(venue, method, camera, request, timings)
        version = serving[1]
        localizer = self._vdm.of(serving[0]) if request.method == "vdm" else serving[0]
        found, narrowed = self._search(localizer, rgb, camera, request, floors, areas)
        result = self._described(_result(venue, version, found, floors, request, camera, narrowed))
        result.timings_ms.update(decode=decoded_ms, total=1e3 * (time.perf_counter() - started))
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


def _no_map(
    venue: str, method: str, camera: QueryCamera, request: LocateRequest, timings_ms: dict[str, float]
) -> LocateResult:
    known = camera.camera.camera if isinstance(camera.camera, ApproximateCamera) else camera.camera
    return LocateResult(
        venue,
        method,
        None,
        "no_map",
        camera=known,
        camera_source=camera.source_of(known),
        gravity_checked=None if request.gravity is None else False,
        timings_ms=timings_ms,
    )


def _result(
    venue: str,
    version: MapVersion,
    found: Localization,
    floors: list[Floor],
    request: LocateRequest,
    camera: QueryCamera,
    narrowed: bool,
) -> LocateResult:
    reason, pose = found.reason, found.world_from_camera
    gravity_checked = None if request.gravity is None else pose is not None and version.z_up
    if gravity_checked and _contradicts(pose, request.gravity):
        reason, pose = "ambiguous", None
    floor = floor_of(floors, pose) if pose is not None else None
    if pose is not None and floors and floor is None:
        reason, pose = "outside_venue", None
    located = pose is not None
    return LocateResult(
        venue=venue,
        method="vdm" if request.method == "vdm" else "rgbd",
        map_version=version.version,
        reason=reason,
        world_from_camera=pose,
        floor=floor,
        plan=plan_point(floor, pose) if floor is not None and pose is not None else None,
        position_m=found.position_m if located else None,
        orientation_deg=found.orientation_deg if located else None,
        confidence=found.confidence if located else 0.0,
        inliers=found.evidence.inliers,
        matches=found.evidence.matches,
        keyframes=found.keyframes,
        camera=found.camera,
        camera_source=camera.source_of(found.camera),
        narrowed=narrowed,
        gravity_checked=gravity_checked,
        timings_ms=dict(found.timings_ms),
    )


def _contradicts(pose: Pose | None, gravity_in_camera: tuple[float, float, float] | None) -> bool:
    if pose is None or gravity_in_camera is None:
        return False
    return angle_to_down_deg(pose, gravity_in_camera) > GRAVITY_LIMIT_DEG
