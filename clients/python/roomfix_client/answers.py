"""What the server answers, as typed dictionaries: the JSON as it is."""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

Reason = Literal["no_match", "too_few_inliers", "ambiguous", "outside_venue", "poor_image", "no_map"]
Tracking = Literal["initializing", "tracking", "relocalized", "lost"]


class Position(TypedDict):
    """A point in metres (centimetres with `axes="unreal"`)."""

    x: float
    y: float
    z: float


class Quaternion(TypedDict):
    """A unit quaternion, scalar last."""

    x: float
    y: float
    z: float
    w: float


class Pose(TypedDict):
    """A pose; that of an answer is world_from_camera."""

    position: Position
    quaternion: Quaternion


class PlanPoint(TypedDict):
    """A point on the floor plan: metres, degrees counter-clockwise from plan x, pixels of the plan image."""

    x: float
    y: float
    heading_deg: float
    u_px: float | None
    v_px: float | None
    area: str | None
    area_name: str | None
    nearest_landmark: str | None
    nearest_landmark_name: str | None
    nearest_landmark_m: float | None


class Accuracy(TypedDict):
    """One sigma."""

    position_m: float
    orientation_deg: float


class Camera(TypedDict):
    """Intrinsics by COLMAP's names, and where they come from."""

    model: str
    width: int
    height: int
    params: list[float]
    source: str | None


class Keyframe(TypedDict):
    """A keyframe that agrees with the pose."""

    keyframe: int
    matches: int
    inliers: int


class ShownMatches(TypedDict):
    """Matches that agree with the pose: u, v of the image, then u, v of the keyframe's picture."""

    keyframe: int
    pairs: list[list[float]]


class GeoPosition(TypedDict):
    """A position in WGS 84: degrees, and metres above the ellipsoid."""

    lat: float
    lon: float
    h: float


class YawPitchRoll(TypedDict):
    """Degrees: yaw counter-clockwise from east, pitch downwards, roll to the right; turns about z, y, x in turn."""

    yaw: float
    pitch: float
    roll: float


class GeoPose(TypedDict):
    """A GeoPose 1.0: the camera's body (x forward, y left, z up) against east, north and up at its position."""

    position: GeoPosition
    quaternion: Quaternion
    angles: YawPitchRoll


class Origin(TypedDict):
    """Where plan (0, 0) of a floor lies on Earth; `heading_deg` is the compass bearing of plan y."""

    latitude: float
    longitude: float
    height_m: float
    heading_deg: float
    floor: str | None


class FrameSupport(TypedDict):
    """The support of the pose by one frame of a query that has several."""

    inliers: int
    matches: int


class LocateResult(TypedDict):
    """Where the camera is, or the reason why that can't be said."""

    located: bool
    reason: Reason | None
    method: str
    venue: str
    map_version: int | None
    floor: str | None
    pose: Pose | None
    plan: PlanPoint | None
    plan_reason: Literal["up_unknown", "scale_unknown"] | None
    accuracy: Accuracy | None
    confidence: float
    inliers: int
    matches: int
    keyframes: list[Keyframe]
    camera: Camera | None
    narrowed: bool
    gravity_checked: bool | None
    timings_ms: dict[str, float]
    anchors: list[str]
    vertical: Literal["gravity", "pois", "upright", "map"] | None
    axes: str
    session_from_world: Pose | None
    hints: list[str]
    shown_matches: ShownMatches | None
    geopose: GeoPose | None
    geopose_reason: Literal["no_origin", "up_unknown", "scale_unknown", "plan_unknown"] | None
    frames: list[FrameSupport]


class TrajectoryPoint(TypedDict):
    """One frame of a trajectory."""

    frame: int
    time_s: float
    tracking: Tracking
    floor: str | None
    x: float | None
    y: float | None
    heading_deg: float | None
    pose: Pose | None
    position_m: float | None


class Guidance(TypedDict, total=False):
    """What a walker does next; which keys there are depends on `problem`."""

    instruction: str | None
    turn: str | None
    distance_m: float | None
    remaining_m: float | None
    off_route: bool
    arrived: bool
    landmark: str | None
    along_m: float | None
    bearing_deg: float | None
    planned: bool
    problem: Literal["lost", "no_route", "off_network"] | None
    detail: str | None
    go_on_m: float | None


class TrackedFrame(LocateResult):
    """The answer to a frame of a session; `received` counts the frames of a stream, from 1."""

    session: str
    frame: int
    tracking: Tracking
    unaided_m: float
    trajectory: list[TrajectoryPoint]
    guidance: Guidance | None
    received: NotRequired[int]


class Session(TypedDict):
    """A session and where it went."""

    session: str
    venue: str
    camera: Any
    destination: str | None
    language: str | None
    share: bool
    tracking: Tracking
    frames: int
    created_at: str
    expires_at: str
    trajectory: list[TrajectoryPoint]


class Venue(TypedDict):
    """A venue; `map_version` is the map that serves it."""

    id: str
    name: str
    created_at: str
    map_version: int | None
    origin: Origin | None


class Build(TypedDict):
    """A build as it is now."""

    build: str
    venue: str
    kind: Literal["scan", "recording", "pictures"]
    priority: int
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    stage: str | None
    done: int
    total: int
    attempts: int
    error: str | None
    error_code: str | None
    report: dict[str, Any] | None
    map_version: int | None
    created_at: str | None
    started_at: str | None
    finished_at: str | None


class Inspection(TypedDict):
    """What a scan holds and what a build would do with it."""

    recognised: list[dict[str, Any]]
    format: str
    frames: int
    discarded: dict[str, int]
    sensors: dict[str, Any]
    duration_s: float
    rate_hz: float | None
    trajectory: dict[str, Any] | None
    examination: dict[str, Any] | None
    loops: dict[str, Any] | None
    build: dict[str, Any]
    notes: list[str]
    path_svg: str | None


class PushedFrame(TypedDict):
    """What became of a monitoring camera's frame."""

    frame: str
    features: int
    pois_visible: list[str]
    received_at: str


class Token(TypedDict):
    """A short-lived token for a phone."""

    token: str
    key: str
    venue: str
    expires_at: str
