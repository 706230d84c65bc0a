"""Locate: from an uploaded image to a pose in the world and a point on the plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidCameraError, InvalidInputError
from app.geometry.anchor_pose import Vertical
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.services.anchor_locator import AnchorLocalization, AnchorLocator
from app.services.anchor_result import place_on_floor
from app.services.floor_plans import HEIGHT_SLACK_M, PlanPoint, floor_of, plan_point
from app.services.localizer import KeyframeVote, Localization, Localizer
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.verification import Reason
from app.storage.floors import Floor, get_floor, list_floors
from app.storage.maps import MapVersion
from app.storage.venues import list_venues
from app.vision.images import Rgb, decode_image

Method = Literal["auto", "rgbd", "vdm", "anchor"]
CameraSource = Literal["request", "search", "unknown"]


@dataclass(frozen=True, slots=True)
class Prior:
    """Where the camera may be: within `radius_m` of a world position (3,)."""

    position: tuple[float, float, float]
    radius_m: float


@dataclass(frozen=True, slots=True)
class LocateRequest:
    """A query. `camera` is a `Camera` (scaled when the image has another size), or the numbers of one for the
    image as it is; without it the focal length is searched for."""

    image: bytes
    venue: str | None = None
    floor: str | None = None
    camera: Camera | tuple[float, ...] | None = None
    gravity: tuple[float, float, float] | None = None
    prior: Prior | None = None
    method: Method = "auto"


@dataclass(frozen=True, slots=True)
class LocateResult:
    """The answer: a pose, or a reason why there is none. `narrowed` says whether floor or prior held the search."""

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
    timings_ms: dict[str, float] = field(default_factory=dict)
    anchors: tuple[str, ...] = ()
    vertical: Vertical | None = None


class LocateService:
    """Answers queries. Safe to share between threads."""

    def __init__(
        self, resources: Resources, library: MapLibrary, anchors: AnchorLocator | None = None
    ) -> None:
        self._resources = resources
        self._library = library
        self._anchors = anchors

    def locate(self, request: LocateRequest) -> LocateResult:
        """Answer a query.

        Raises `NotFoundError` for an unknown venue or floor, `InvalidImageError`, `InvalidCameraError` and
        `InvalidInputError` for a request that can't be answered.
        """
        started = time.perf_counter()
        if request.method == "vdm":
            raise InvalidInputError(f"method {request.method!r} is not available; use auto, rgbd or anchor.")
        venue = self._venue(request.venue)
        floors = self._floors(venue, request.floor)
        rgb = decode_image(request.image, self._resources.settings.max_image_pixels)
        decoded_ms = 1e3 * (time.perf_counter() - started)
        camera = query_camera(request.camera, rgb)
        if request.method == "anchor":
            return self._by_anchor(venue, rgb, camera, request, floors, decoded_ms)
        serving = self._library.active(venue)
        if serving is None:
            if request.method == "auto" and camera is not None:
                return self._by_anchor(venue, rgb, camera, request, floors, decoded_ms)
            timings = {"decode": decoded_ms, "total": 1e3 * (time.perf_counter() - started)}
            return LocateResult(venue, "rgbd", None, "no_map", camera=camera, timings_ms=timings)
        localizer, version = serving
        found, narrowed = self._search(localizer, rgb, camera, request, floors)
        result = _result(venue, version, found, floors, request, narrowed)
        result.timings_ms.update(decode=decoded_ms, total=1e3 * (time.perf_counter() - started))
        if result.reason is not None and request.method == "auto" and camera is not None:
            other = self._by_anchor(venue, rgb, camera, request, floors, decoded_ms)
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
        if self._anchors is None:
            raise InvalidInputError("method anchor is not available here; use a server.")
        found = self._anchors.locate(venue, request.floor, rgb, camera, request.gravity)
        result = _anchor_result(venue, found, floors, camera)
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

    def _search(
        self,
        localizer: Localizer,
        rgb: Rgb,
        camera: Camera | None,
        request: LocateRequest,
        floors: list[Floor],
    ) -> tuple[Localization, bool]:
        """Search where floor and prior say; where that finds nothing, everywhere."""
        allowed = allowed_keyframes(localizer, request, floors)
        if allowed is not None and len(allowed):
            found = localizer.localize(rgb, camera, allowed)
            if found.world_from_camera is not None:
                return found, True
        return localizer.localize(rgb, camera), False


def query_camera(camera: Camera | tuple[float, ...] | None, rgb: Rgb) -> Camera | None:
    """Return the camera of the image as it was decoded; raises `InvalidCameraError` when it can't be its own."""
    height, width = rgb.shape[:2]
    if isinstance(camera, Camera):
        if (camera.width > camera.height) != (width > height) and camera.width != camera.height:
            raise InvalidCameraError(
                f"The camera is for {camera.width} x {camera.height} pixels, the upright image has {width} x "
                f"{height}: give the intrinsics of the image as its EXIF orientation turns it."
            )
        return camera.scaled_to(width, height)
    if camera is not None:
        return Camera.from_values(camera, width, height)
    return None


def allowed_keyframes(
    localizer: Localizer, request: LocateRequest, floors: list[Floor]
) -> NDArray[np.int64] | None:
    """Return the keyframes that floor and prior leave, or None when neither is given."""
    if request.floor is None and request.prior is None:
        return None
    positions = localizer.artifact.arrays.positions
    keep = np.ones(len(positions), dtype=bool)
    if request.floor is not None:
        floor = next(f for f in floors if f.id == request.floor)
        keep &= (positions[:, 2] >= floor.z_min_m - HEIGHT_SLACK_M) & (
            positions[:, 2] <= floor.z_max_m + HEIGHT_SLACK_M
        )
    if request.prior is not None:
        # A keyframe a few metres outside may still see what a camera inside sees.
        distances = np.linalg.norm(positions - np.array(request.prior.position), axis=1)
        keep &= distances <= request.prior.radius_m + 3.0
    return np.flatnonzero(keep).astype(np.int64)


def _result(
    venue: str,
    version: MapVersion,
    found: Localization,
    floors: list[Floor],
    request: LocateRequest,
    narrowed: bool,
) -> LocateResult:
    reason, pose = found.reason, found.world_from_camera
    floor = floor_of(floors, pose) if pose is not None else None
    if pose is not None and floors and floor is None:
        reason, pose = "outside_venue", None
    located = pose is not None
    source: CameraSource = "request" if request.camera is not None else "search"
    return LocateResult(
        venue=venue,
        method="rgbd",
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
        camera_source="unknown" if found.camera is None else source,
        narrowed=narrowed,
        timings_ms=dict(found.timings_ms),
    )


def _anchor_result(
    venue: str, found: AnchorLocalization, floors: list[Floor], camera: Camera
) -> LocateResult:
    """Return the result of an answer by anchors; outside the floor it is none."""
    place = None
    if found.plan_from_phone is not None and found.floor_id is not None:
        place = place_on_floor(floors, found.floor_id, found.plan_from_phone)
    located = place is not None
    return LocateResult(
        venue=venue,
        method="anchor",
        map_version=None,
        reason=None if located else found.reason or "outside_venue",
        world_from_camera=None if place is None else place.world_from_camera,
        floor=None if place is None else place.floor,
        plan=None if place is None else place.plan,
        position_m=found.position_m if located else None,
        orientation_deg=found.orientation_deg if located else None,
        confidence=found.confidence if located else 0.0,
        inliers=found.inliers,
        matches=found.matches,
        camera=camera,
        camera_source="request",
        timings_ms=dict(found.timings_ms),
        anchors=found.anchors if located else (),
        vertical=found.vertical if located else None,
    )
