"""Sessions: each frame of a moving phone goes through its tracker, and what came of it is kept before the answer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from functools import partial
from threading import Lock
from typing import Any

from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint, floor_of, plan_point
from app.engine.maps.open_map import OpenMap
from app.engine.navigation.floor_changes import can_have_changed_floor
from app.engine.navigation.places import PlanPlace
from app.engine.query.camera import scanned_camera
from app.engine.query.camera_sources import CameraSource, query_camera
from app.engine.stage_timer import StageTimer
from app.engine.tracking.anchor_fixes import AnchorFixes, FirstFixes
from app.engine.tracking.fix import FixSource, MapFixes
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.memory import (
    memory_from_json,
    memory_to_json,
)
from app.engine.tracking.plan_walk.plan_tracker import PlanTracker
from app.engine.tracking.plan_walk.plans import Plans
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracked import Tracked
from app.engine.tracking.tracker import Tracker
from app.errors import ConflictError, InvalidCameraError, NotFoundError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of, parse_camera_hint
from app.geometry.se3 import Pose
from app.limits import limit
from app.lru import LruCache
from app.services.anchor_locator import AnchorLocator
from app.services.floor_features import FeatureLibrary
from app.services.localizers import localizer_on
from app.services.locate_result import on_earth
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.routes import RouteService
from app.services.session_answer import SessionResult, place_of, plan_reason_of, point_of, result_of
from app.services.session_guidance import SessionGuide, Way
from app.services.trajectories.path import PathSinceFix, moved_points, recent_points
from app.storage.floors import list_floors
from app.storage.sessions import (
    Session,
    SessionPoint,
    change_session,
    create_session,
    delete_expired_sessions,
    delete_session,
    get_session,
    list_points,
    record_frame,
)
from app.storage.venues import earth_of, get_venue
from app.vision.images import Rgb, decode_image


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """What an answer to a frame brings, and how long it waits to be stored."""

    recent_points: int = limit(
        10,
        "Points of the trajectory in every answer; `GET` gives the others.",
        chosen="By hand: a second or two of a walk, for drawing it.",
    )
    record_wait_s: float = limit(
        2.0,
        "Time that a frame waits for the lock of the database before it is refused.",
        chosen="By hand: a frame is of no use after that, and the thread that waits is one that computes.",
    )


OPTIONS = SessionOptions()


@dataclass(frozen=True, slots=True)
class SessionFrame:
    """A frame of a session. `camera` and `gravity` as in `LocateRequest`, the camera in place of the session's;
    `motion` is this camera in the axes of the previous frame's; `time_s` when it was taken, by the phone's clock."""

    image: bytes
    camera: CameraHint | None = None
    motion: Pose | None = None
    time_s: float | None = None
    gravity: tuple[float, float, float] | None = None


@dataclass(slots=True, kw_only=True)
class _Live:
    """What a session has in memory: lost without harm. `frames` says after which frame it is up to date."""

    tracker: Tracker | PlanTracker = field(default_factory=Tracker)
    frames: int = -1
    recent: list[SessionPoint] = field(default_factory=list)
    way: Way = field(default_factory=Way)
    path: PathSinceFix = field(default_factory=PathSinceFix)
    lock: Lock = field(default_factory=Lock)


class SessionService:
    """Answers the frames of sessions. Safe to share between threads; one frame of a session at a time."""

    def __init__(
        self,
        resources: Resources,
        library: MapLibrary,
        features: FeatureLibrary,
        routes: RouteService,
        anchors: AnchorLocator | None = None,
        tracking: TrackerSettings | None = None,
    ) -> None:
        self._resources = resources
        self._library = library
        self._features = features
        self._routes = routes
        self._guide = SessionGuide(routes)
        self._anchors = anchors
        self._tracking = tracking or TrackerSettings()
        self._live: LruCache[str, _Live] = LruCache(resources.settings.session_live_max)

    @property
    def timeout(self) -> timedelta:
        """How long a session lives without a frame."""
        return timedelta(seconds=self._resources.settings.session_timeout_s)

    def create(
        self,
        venue: str,
        camera: object = None,
        destination: str | None = None,
        language: str | None = None,
        *,
        share: bool = False,
    ) -> Session:
        """Start a session; raises `NotFoundError` for an unknown venue or destination, `InvalidInputError` for a bad
        camera, destination or language."""
        values = _json_of(parse_camera_hint(camera))
        with self._resources.database.read() as connection:
            get_venue(connection, venue)
        self._guide.check(venue, destination, language)
        with self._resources.database.write() as connection:
            delete_expired_sessions(connection, self.timeout)
            get_venue(connection, venue)
            return create_session(connection, venue, values, destination, language, share=share)

    def get(self, session_id: str) -> Session:
        """Return a session; raises `NotFoundError`."""
        with self._resources.database.read() as connection:
            return get_session(connection, session_id, self.timeout)

    def trajectory(self, session_id: str, count: int) -> list[SessionPoint]:
        """Return the last points of where a session went; raises `NotFoundError`."""
        with self._resources.database.read() as connection:
            get_session(connection, session_id, self.timeout)
            return list_points(connection, session_id, count)

    def change(self, session_id: str, values: dict[str, Any]) -> Session:
        """Change destination, language, camera or `share`; raises `NotFoundError`, `InvalidInputError`."""
        self._guide.check(self.get(session_id).venue_id, values.get("destination"), values.get("language"))
        if "camera" in values:
            values = {**values, "camera": _json_of(parse_camera_hint(values["camera"]))}
        with self._resources.database.write() as connection:
            get_session(connection, session_id, self.timeout)
            change_session(connection, session_id, values)
            if "camera" in values:
                # What was followed with the old one is void.
                self._live.drop(session_id)
            return get_session(connection, session_id, self.timeout)

    def place(self, session_id: str, venue_id: str) -> PlanPlace:
        """Return where a session of a venue was last; raises `NotFoundError`, and `ConflictError` before it was
        located."""
        if self.get(session_id).venue_id != venue_id:
            raise NotFoundError(f"There is no such session in venue {venue_id!r}.")
        located = [
            point for point in self.trajectory(session_id, OPTIONS.recent_points) if point.plan is not None
        ]
        if not located or located[-1].floor is None or located[-1].plan is None:
            raise ConflictError(
                "The session has not been located on a floor's plan lately: send it frames first."
            )
        return PlanPlace(located[-1].floor, located[-1].plan[0], located[-1].plan[1])

    def delete(self, session_id: str) -> None:
        """Delete a session; raises `NotFoundError`."""
        with self._resources.database.write() as connection:
            delete_session(connection, session_id)
        self._live.drop(session_id)

    def process(self, session_id: str, frame: SessionFrame) -> SessionResult:
        """Answer a frame. What it led to is committed when this returns.

        Raises `NotFoundError` for a session that is not there (any more), `ConflictError` while another frame of
        it is worked on, `InvalidImageError` and `InvalidCameraError` for a frame that can't be used: then nothing
        has changed.
        """
        timer = StageTimer()
        live = self._live.get_or_make(session_id, _Live)
        if not live.lock.acquire(blocking=False):
            raise ConflictError(
                "Another frame of this session is being worked on: wait for its answer, or use the stream."
            )
        try:
            session = self.get(session_id)
            self._bring_up_to_date(live, session)
            return self._answer(session, live, frame, timer)
        except NotFoundError:
            self._live.drop(session_id)
            raise
        finally:
            live.lock.release()

    def _bring_up_to_date(self, live: _Live, session: Session) -> None:
        """Read from the database what memory doesn't hold: after a restart, or when another server had frames."""
        if live.frames == session.frames:
            return
        with self._resources.database.read() as connection:
            live.recent = list_points(connection, session.id, OPTIONS.recent_points)
        live.tracker, live.path = Tracker(memory_from_json(session.memory), self._tracking), PathSinceFix()
        live.frames = session.frames

    def _answer(self, session: Session, live: _Live, frame: SessionFrame, timer: StageTimer) -> SessionResult:
        rgb = decode_image(frame.image, self._resources.settings.max_image_pixels)
        timer.lap("decode")
        given = frame.camera if frame.camera is not None else _own_camera(session, live.tracker, rgb)
        known = query_camera(given, rgb, frame.image).camera
        # What EXIF says is too rough to follow points by; the first fix searches for the focal length.
        camera = known if isinstance(known, Camera) else None
        serving = self._library.active(session.venue_id)
        opened = None if serving is None else serving[0]
        behind_lens = (
            camera if camera is None or opened is None else scanned_camera(opened.artifact.metadata, camera)
        )
        with self._resources.database.read() as connection:
            floors = list_floors(connection, session.venue_id)
            earth = earth_of(connection, session.venue_id, floors)
        surroundings = self._surroundings(session.venue_id, opened, floors)
        tracker = _tracker_for(live, surroundings.plans, self._tracking)
        before = tracker.memory
        time_s = time.time() if frame.time_s is None else frame.time_s
        taken = TrackingFrame.of(rgb, time_s, frame.gravity, behind_lens, frame.motion)
        tracked = tracker.process(taken, surroundings)
        timer.lap("track")
        plan_reason = plan_reason_of(tracked, serving)
        floor, plan = self._place(tracked, floors, has_plan=plan_reason is None)
        point = point_of(session.frames + 1, time_s, tracked, floor, plan)
        path = live.path.copy()
        corrected = moved_points(path.add(tracked, point), floors, has_plan=plan_reason is None)
        try:
            self._record(session, tracker, given is None, point, corrected)
        except BaseException:
            tracker.forget(before)
            raise
        live.frames, live.path = point.frame, path
        live.recent = recent_points(live.recent, corrected, point, OPTIONS.recent_points)
        answer = replace(
            result_of(session, tracked, floor, plan),
            plan_reason=plan_reason,
            map_version=None if serving is None else serving[1].version,
            # What was given is answered as it was given.
            **_camera_of(session, camera or tracker.camera),
            timings_ms={**timer.milliseconds, "total": timer.total_ms},
        )
        return SessionResult(
            result=on_earth(answer, earth),
            session=session.id,
            frame=point.frame,
            tracking=tracked.state,
            unaided_m=tracked.unaided_m,
            trajectory=tuple(live.recent),
            guidance=self._guidance(live, session, floor, plan, tracked, time_s),
        )

    def _guidance(
        self,
        live: _Live,
        session: Session,
        floor: Floor | None,
        plan: PlanPoint | None,
        tracked: Tracked,
        time_s: float,
    ) -> dict[str, Any] | None:
        return self._guide.guidance(
            live.way,
            session.venue_id,
            session.destination,
            session.language,
            floor,
            plan,
            tracked.placed is not None,
            time_s,
            tracked.accuracy.position_m if tracked.accuracy else 0.0,
        )

    def _place(
        self, tracked: Tracked, floors: list[Floor], *, has_plan: bool
    ) -> tuple[Floor | None, PlanPoint | None]:
        """Return the floor and the described plan position, None where the map has no plan."""
        floor, plan = place_of(tracked, floors)
        if floor is None or plan is None or not has_plan:
            return floor, None
        return floor, self._features.described(plan, floor)

    def _surroundings(self, venue_id: str, opened: OpenMap | None, floors: list[Floor]) -> Surroundings:
        """Return what gives fixes, the map and the anchors where it shows nothing, and where a camera can be."""
        sources: list[FixSource] = (
            []
            if opened is None
            else [MapFixes(localizer_on(self._resources.settings, opened, second_look=False))]
        )
        anchors = None
        if self._anchors is not None:
            anchors = AnchorFixes(partial(self._anchors.locate, venue_id, None), floors)
            sources.append(anchors)
        return Surroundings(
            FirstFixes(sources),
            is_inside=lambda pose: not floors or floor_of(floors, pose) is not None,
            can_change_floor=lambda pose, away_s: self._can_change_floor(venue_id, floors, pose, away_s),
            plans=None if opened is not None or anchors is None else self._features.plans(floors),
            anchors=anchors,
        )

    def _can_change_floor(self, venue_id: str, floors: list[Floor], pose: Pose, away_s: float) -> bool:
        floor = floor_of(floors, pose)
        plan = None if floor is None else plan_point(floor, pose)
        if floor is None or plan is None:
            return len(floors) > 1
        network = self._routes.network(venue_id)
        return can_have_changed_floor(network, PlanPlace(floor.id, plan.x, plan.y), away_s)

    def _record(
        self,
        session: Session,
        tracker: Tracker | PlanTracker,
        searched: bool,
        point: SessionPoint,
        corrected: Sequence[SessionPoint],
    ) -> None:
        camera = session.camera
        if searched and tracker.camera is not None:
            camera = {**hint_of(tracker.camera).to_json(), "source": "search"}
        keep = self._resources.settings.session_trajectory_points
        with self._resources.database.write(OPTIONS.record_wait_s) as connection:
            record_frame(connection, session, camera, memory_to_json(tracker.memory), point, keep, corrected)


def _tracker_for(live: _Live, plans: Plans | None, settings: TrackerSettings) -> Tracker | PlanTracker:
    """Return the session's tracker: one that goes by `plans` where these have walls."""
    kind = PlanTracker if plans is not None and plans.has_walls else Tracker
    if not isinstance(live.tracker, kind):
        before = live.tracker
        live.tracker = kind(before.memory, settings)
        live.tracker.camera = before.camera
    return live.tracker


def _own_camera(session: Session, tracker: Tracker | PlanTracker, rgb: Rgb) -> CameraHint | None:
    """Return the session's camera; None for one that was searched for and doesn't fit the image, since the phone
    was turned: then it is searched for again."""
    stored = session.camera
    if isinstance(stored, dict):
        stored = {name: value for name, value in stored.items() if name != "source"}
    own = parse_camera_hint(stored)
    if _was_searched(session):
        try:
            query_camera(own, rgb, b"")
        except InvalidCameraError:
            own = tracker.camera = None
    return own


def _json_of(hint: CameraHint | None) -> Any:
    return None if hint is None else hint.to_json()


def _was_searched(session: Session) -> bool:
    stored = session.camera
    return stored is None or (isinstance(stored, dict) and stored.get("source") == "search")


def _camera_of(session: Session, camera: Camera | None) -> dict[str, Any]:
    source: CameraSource = "search" if _was_searched(session) else "request"
    return {"camera": camera, "camera_source": "unknown" if camera is None else source}
