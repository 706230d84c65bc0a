"""What is asked of locate, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from app.engine.anchors.locator import AnchorLocalization
from app.engine.anchors.place_on_floor import place_on_floor
from app.engine.floors.earth import Earth, GeoPoseReason, PlanReason, geopose_in
from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint, floor_of, plan_point
from app.engine.query.camera_sources import CameraSource, QueryCamera
from app.engine.query.hints import Hint
from app.engine.query.localization import KeyframeVote, Localization
from app.engine.query.narrowing import Prior
from app.engine.query.placed import Accuracy, Support
from app.engine.query.shown_matches import ShownMatches
from app.engine.query.upright import contradicts_gravity
from app.engine.query.verification import Limits, Reason
from app.geometry.anchor_pose import Vertical
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.geometry.geopose import GeoPose
from app.geometry.se3 import Pose
from app.storage.maps import MapVersion

Method = Literal["auto", "rgbd", "vdm", "anchor"]
# Of pictures refused for these reasons the best pose may be anywhere.
UNFOUNDED = ("no_match", "too_few_inliers", "poor_image", "no_map")


@dataclass(frozen=True, slots=True, kw_only=True)
class LaterFrame:
    """A further picture of a query, its camera as in `LocateRequest`, and its camera's pose in that of the first
    picture, None where the motion is not known."""

    image: bytes
    camera: CameraHint | None = None
    first_from_camera: Pose | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LocateRequest:
    """A query. `camera` is a `Camera` (scaled when the image has another size), or the numbers of one for the
    image as it is; without it EXIF, a list of phones or a search tells the focal length. `gravity` is the direction
    of down in camera axes, `area` an area's id or name. `show_matches` asks for matches to draw. A pose that is wrong
    by more than 0.5 m or 5 degrees with a higher probability than `max_risk` is not wanted. The answer is about
    `image`; the `later` frames of a burst or a rig, all with a motion or none, help to find it."""

    image: bytes
    venue: str | None = None
    floor: str | None = None
    camera: CameraHint | None = None
    gravity: tuple[float, float, float] | None = None
    prior: Prior | None = None
    method: Method = "auto"
    area: str | None = None
    show_matches: bool = False
    max_risk: float = 1.0
    later: tuple[LaterFrame, ...] = ()


@dataclass(frozen=True, slots=True)
class Suspected:
    """Where a refused picture seems to have been taken: counted, never answered."""

    floor: Floor
    plan: PlanPoint | None


@dataclass(frozen=True, slots=True, kw_only=True)
class LocateResult:
    """The answer: a pose, or a reason why there is none.

    `narrowed` says whether floor, area or prior held the search; `gravity_checked` whether the pose that was found
    was compared with the request's gravity, None when there was none. `plan_reason` says why a pose on a floor has no
    plan position: `up_unknown`, while the map's z axis is not known to point up, or `scale_unknown`, while its unit is
    not known to be the metre. `hints` say what would help a picture that is not located. `frames` is the support by
    each frame of a query that has several. `geopose` is where on Earth the camera is, `geopose_reason` why that is not
    known of a located one. `suspected` is for operators alone, as is `contradicted`: whether much of the picture is not
    what the map holds there, None where no map was asked for this very picture, as of a session's frames.
    """

    venue: str
    method: str
    map_version: int | None
    reason: Reason | None
    world_from_camera: Pose | None = None
    floor: Floor | None = None
    plan: PlanPoint | None = None
    plan_reason: PlanReason | None = None
    accuracy: Accuracy | None = None
    confidence: float = 0.0
    support: Support = Support()
    keyframes: tuple[KeyframeVote, ...] = ()
    camera: Camera | None = None
    camera_source: CameraSource = "unknown"
    narrowed: bool = False
    gravity_checked: bool | None = None
    timings_ms: dict[str, float] = field(default_factory=dict)
    anchors: tuple[str, ...] = ()
    vertical: Vertical | None = None
    hints: tuple[Hint, ...] = ()
    shown_matches: ShownMatches | None = None
    geopose: GeoPose | None = None
    geopose_reason: GeoPoseReason | None = None
    frames: tuple[Support, ...] = ()
    suspected: Suspected | None = None
    contradicted: bool | None = None


def map_result(
    venue: str,
    version: MapVersion,
    found: Localization,
    narrowed: bool,
    floors: list[Floor],
    request: LocateRequest,
    camera: QueryCamera,
) -> LocateResult:
    """Return the result of an answer by a map version, for what is known of the query's camera."""
    reason, pose = found.reason, found.world_from_camera
    if pose is not None and _is_too_risky(found.confidence, request):
        reason, pose = "too_few_inliers", None
    z_up, has_scale, plan_reason = version.z_up, version.has_scale, version.plan_reason
    gravity_checked = None if request.gravity is None else pose is not None and z_up
    if gravity_checked and contradicts_gravity(pose, request.gravity):
        reason, pose = "ambiguous", None
    # The heights of floors are in metres.
    floors = floors if has_scale else []
    floor = floor_of(floors, pose) if pose is not None else None
    if pose is not None and floors and floor is None:
        reason, pose = "outside_venue", None
    located = pose is not None
    # What was given is answered as it was given; a focal length that led to no pose is not known.
    searched = found.camera if located else None
    is_refined = located and found.camera_trust == "refined"
    own = camera.camera if isinstance(camera.camera, Camera) and not is_refined else searched
    return LocateResult(
        venue=venue,
        method="vdm" if request.method == "vdm" else "rgbd",
        map_version=version.version,
        reason=reason,
        world_from_camera=pose,
        floor=floor,
        plan=plan_point(floor, pose) if floor is not None and pose is not None and z_up else None,
        plan_reason=plan_reason if pose is not None else None,
        accuracy=found.accuracy if located else None,
        confidence=found.confidence if located else 0.0,
        support=Support(found.evidence.inliers, found.evidence.matches),
        keyframes=found.keyframes,
        camera=own,
        camera_source="refined" if is_refined else camera.source_of(own),
        narrowed=narrowed,
        gravity_checked=gravity_checked,
        timings_ms=dict(found.timings_ms),
        hints=() if located else _hints(found, reason, camera),
        frames=found.frames,
        suspected=None if located else _suspected(found, floors, z_up),
        contradicted=found.evidence.contradicted > Limits().max_contradicted_share_of_twin,
    )


def _suspected(found: Localization, floors: list[Floor], z_up: bool) -> Suspected | None:
    """Return where the pose is that was refused; None where too little speaks for it to mean a place."""
    pose = found.candidate
    if pose is None or found.reason in UNFOUNDED:
        return None
    floor = floor_of(floors, pose)
    return None if floor is None else Suspected(floor, plan_point(floor, pose) if z_up else None)


def _hints(found: Localization, reason: Reason | None, camera: QueryCamera) -> tuple[Hint, ...]:
    """Return what would help: what the search says, or, where only floors or gravity refuse its pose, that."""
    hints = found.hints
    if found.world_from_camera is not None:
        hints = ("go_where_it_is_mapped",) if reason == "outside_venue" else ("look_elsewhere",)
    return hints if isinstance(camera.camera, Camera) else (*hints, "send_camera")


def _is_too_risky(confidence: float, request: LocateRequest) -> bool:
    """Return whether an answer is less sure than a request wants it."""
    return confidence < 1.0 - request.max_risk


def anchor_result(
    venue: str, found: AnchorLocalization, floors: list[Floor], request: LocateRequest, camera: Camera
) -> LocateResult:
    """Return the result of an answer by anchors; outside the floor, or less sure than wanted, it is none."""
    place, reason = None, found.reason
    if reason is None and _is_too_risky(found.confidence, request):
        reason = "too_few_inliers"
    elif found.plan_from_phone is not None and found.floor_id is not None:
        place = place_on_floor(floors, found.floor_id, found.plan_from_phone)
    located = place is not None
    return LocateResult(
        venue=venue,
        method="anchor",
        map_version=None,
        reason=None if located else reason or "outside_venue",
        world_from_camera=None if place is None else place.world_from_camera,
        floor=None if place is None else place.floor,
        plan=None if place is None else place.plan,
        accuracy=found.accuracy if located else None,
        confidence=found.confidence if located else 0.0,
        support=found.support,
        camera=camera,
        camera_source="request",
        timings_ms=dict(found.timings_ms),
        anchors=found.anchors if located else (),
        vertical=found.vertical if located else None,
    )


def on_earth(result: LocateResult, earth: Earth | None) -> LocateResult:
    """Return a result that says where on Earth the camera is, or why not."""
    geopose, reason = geopose_in(
        earth,
        result.world_from_camera,
        is_located=result.reason is None,
        plan_reason=result.plan_reason,
    )
    return replace(result, geopose=geopose, geopose_reason=reason)
