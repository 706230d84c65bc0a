"""One moving camera: fixes, odometry between them, and what may be believed of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.engine.query.placed import WORLD, Accuracy, PlacedPose, Support
from app.engine.query.verification import Reason
from app.engine.tracking.belief import (
    BELIEF,
    can_be_followed,
    is_confirmed,
    is_inside,
    is_plausible,
    may_be_elsewhere,
)
from app.engine.tracking.drift import accuracy_after, reach_m, unaided
from app.engine.tracking.events import (
    Corrected,
    Doubted,
    Event,
    Followed,
    Found,
    Returned,
    Unsearched,
    Unseen,
)
from app.engine.tracking.fix import Fix, NoFix, confidence_of_sigma
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.joining import at_scale_of_both
from app.engine.tracking.odometry.visual_odometry import Odometry, OdometryStep
from app.engine.tracking.own_views import OwnViews
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.state import State, TrackingMemory
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracked import Tracked
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.se3 import Pose, position_difference_m


class Tracker:
    """Tracks one camera through its frames, one at a time.

    `memory` may come from an earlier process: without the points of its last frame, the next one is located
    anew, and believed at once only near where the camera was.
    """

    def __init__(self, memory: TrackingMemory | None = None, settings: TrackerSettings | None = None) -> None:
        self.memory = memory or TrackingMemory()
        self.camera: Camera | None = None
        self._settings = settings or TrackerSettings()
        self._odometry: Odometry | None = None
        self._own_views = OwnViews()
        self._since_refresh = self._since_search = 0
        self._searched_s = -1e9
        self._why_lost: Reason = "no_match"

    def process(  # noqa: PLR0911 - one line for each event
        self, frame: TrackingFrame, surroundings: Surroundings
    ) -> Tracked:
        """Answer for a frame.

        Without a camera in the frame the one that an earlier frame's search found is used, or it is searched for.
        Raises `InvalidCameraError` for a camera that can't be the frame's.

        The states, and what leads from one to the next:

        | from | event | to |
        | --- | --- | --- |
        | any | `Followed`: odometry is trusted, no fix corrects it | tracking |
        | any | `Corrected`: a fix agrees with odometry | tracking; lost when their scales contradict each other |
        | any | `Returned`: a view of the session's own past corrects odometry | tracking; relocalized after lost |
        | initializing, tracking | `Found`: a fix alone, believed | tracking |
        | lost, or farther away | `Found`: a fix alone, believed | relocalized (an answer; then as tracking) |
        | any | `Doubted`: a fix where the camera can't have come | lost, the fix waits for confirmation |
        | initializing | `Unseen` | initializing |
        | others | `Unseen`, `Unsearched` | lost |
        """
        if frame.camera is not None:
            self.camera = frame.camera
        self._since_refresh += 1
        self._since_search += 1
        event = self._observe(frame, surroundings)
        match event:
            case Followed():
                return self._go_on(event, frame)
            case Corrected():
                return replace(self._join(event, frame), by_odometry=event.step.frame_from_camera)
            case Returned():
                return self._come_back(event, frame)
            case Found():
                return self._take(event.fix, frame, "relocalized" if event.resumed else "tracking")
            case Doubted():
                return self._doubt(event, frame)
            case Unseen():
                return self._miss(event, frame)
            case Unsearched():
                self.memory = replace(self.memory, state="lost")
                return self._nothing("lost", Unseen(self._why_lost, NoFix("no_match").support, event.camera))

    def forget(self, memory: TrackingMemory) -> None:
        """Go back to an earlier memory: the last frame never was."""
        self.memory, self._odometry, self._own_views = memory, None, OwnViews()

    # What the frame shows.

    def _observe(self, frame: TrackingFrame, surroundings: Surroundings) -> Event:
        """Return what a frame turned out to be: odometry's step with or without a fix, else a fix alone."""
        camera = self._tracking_camera(frame)
        last = self.memory.frame_from_camera
        predicted = last if last is None or frame.motion is None else last @ frame.motion
        step = self._followed(frame, camera, predicted, surroundings)
        if step is None or camera is None:
            return self._search(frame, camera, predicted, surroundings)
        accuracy = accuracy_after(self.memory, step)
        fix = self._due_fix(frame, camera, step, surroundings)
        if fix is None:
            return self._seen_again(frame, camera, step) or Followed(step, camera)
        self._since_search = 0
        off_m = position_difference_m(fix.frame_from_camera, step.frame_from_camera)
        sigma_m = float(np.hypot(accuracy.position_m, fix.accuracy.position_m))
        agrees = off_m <= self._settings.max_correction_m + 3.0 * sigma_m
        if fix.frame_id == self.memory.frame_id and agrees:
            return Corrected(step, accuracy, fix)
        # One of both is wrong: neither is believed until a second fix agrees.
        return Doubted(fix, camera)

    def _tracking_camera(self, frame: TrackingFrame) -> Camera | None:
        if self.camera is None:
            return None
        camera, lens = frame.scaled(self.camera), self._own_lens()
        return camera if lens is None else lens.of(camera)

    def _own_lens(self) -> Lens | None:
        """Return the lens that is learned from the frames, a pinhole's; None where the distortion is stated."""
        is_stated = self.camera is None or self.camera.model != "PINHOLE"
        return None if is_stated else Lens(*self.memory.lens)

    def _followed(
        self,
        frame: TrackingFrame,
        camera: Camera | None,
        predicted: Pose | None,
        surroundings: Surroundings,
    ) -> OdometryStep | None:
        """Return odometry's step to a frame if it can be trusted."""
        odometry, memory, settings = self._odometry, self.memory, self._settings
        if odometry is None or camera is None or predicted is None:
            return None
        if odometry.size_px != frame.size_px or abs(frame.time_s - memory.time_s) > settings.max_gap_s:
            return None
        step = odometry.step(frame, camera, predicted)
        if step is None or not step.can_be_trusted:
            return None
        if memory.frame_id == WORLD and not surroundings.is_inside(step.frame_from_camera):
            return None
        return step if can_be_followed(memory, step, frame, predicted, settings) else None

    def _due_fix(
        self, frame: TrackingFrame, camera: Camera, step: OdometryStep, surroundings: Surroundings
    ) -> Fix | None:
        """Return a fix beside odometry's step, when one is due and there is one."""
        fix = self._refreshed(frame, camera, step, surroundings)
        due = self._settings.use_relocation and self._since_search >= self._search_every()
        if fix is not None or not due:
            return fix
        self._since_search = 0
        found = surroundings.source.locate(frame, camera, step.frame_from_camera)
        return found if isinstance(found, Fix) else None

    def _seen_again(self, frame: TrackingFrame, camera: Camera, step: OdometryStep) -> Returned | None:
        """Return what an earlier view of this session says of the place, when the frame shows one again."""
        if not self._settings.use_own_views:
            return None
        near, accuracy = step.frame_from_camera, accuracy_after(self.memory, step)
        within_m = self._settings.max_correction_m + 3.0 * accuracy.position_m
        seen = self._own_views.find(frame.gray, camera, near, self.memory, accuracy, within_m)
        return None if seen is None else Returned(step, seen, camera)

    def _search_every(self) -> int:
        """Return after how many frames map or anchor are asked again: soon while the scale rests on an anchor."""
        sigma, settings = self.memory.fix_scale_sigma, self._settings
        if sigma <= 0.0:
            return settings.relocalize_every
        is_known = sigma <= settings.wanted_scale_sigma
        every = settings.known_scale_every if is_known else settings.unknown_scale_every
        return min(every, settings.relocalize_every)

    def _refreshed(
        self, frame: TrackingFrame, camera: Camera, step: OdometryStep, surroundings: Surroundings
    ) -> Fix | None:
        """Return the map's fix around odometry's pose when one is due: by frames, by path or by turns."""
        settings, memory = self._settings, self.memory
        if not (settings.use_refresh and settings.use_relocation) or memory.frame_id != WORLD:
            return None
        path_m, turn_rad = unaided(memory, step)
        moved = path_m >= settings.refresh_path_m or turn_rad >= settings.refresh_turn_rad
        if self._since_refresh < settings.refresh_every and not moved:
            return None
        self._since_refresh = 0
        fix = surroundings.source.refresh(frame, camera, step.frame_from_camera)
        if fix is not None or not moved:
            return fix
        within_m = settings.max_astray_m + 3.0 * accuracy_after(memory, step).position_m
        return surroundings.source.nearby(frame, camera, step.frame_from_camera, within_m)

    def _search(  # noqa: PLR0911 - one line for each event
        self,
        frame: TrackingFrame,
        camera: Camera | None,
        predicted: Pose | None,
        surroundings: Surroundings,
    ) -> Event:
        """Return what a fix alone says of a frame that odometry did not follow."""
        memory, settings, self._odometry = self.memory, self._settings, None
        self._since_search = self._since_refresh = 0
        away_s = abs(frame.time_s - memory.time_s)
        is_closed = memory.last is not None and not settings.use_relocation
        if not is_closed and away_s <= settings.max_nearby_s:
            near = self._near_last(frame, camera, predicted, surroundings)
            if near is not None:
                return Found(near, memory.state == "lost")
        if is_closed or self._just_searched(frame.time_s):
            return self._remembered(frame, camera) or Unsearched(camera)
        self._searched_s = frame.time_s
        prior = predicted if away_s <= settings.max_prior_s else None
        any_floor = may_be_elsewhere(memory, frame.time_s, surroundings)
        found = surroundings.source.locate(frame, camera, prior, any_floor)
        if isinstance(found, NoFix):
            return self._remembered(frame, camera) or Unseen(found.reason, found.support, camera)
        if not is_inside(found, surroundings):
            return Unseen("outside_venue", found.support, camera)
        if predicted is None:
            return Found(found, resumed=False)
        if is_plausible(memory, found, predicted, frame.time_s) or is_confirmed(
            memory, found, frame.time_s, surroundings
        ):
            return Found(found, resumed=True)
        return Doubted(found, camera)

    def _remembered(self, frame: TrackingFrame, camera: Camera | None) -> Returned | None:
        """Return what an earlier view of this session says of a lost frame; none while a fix contradicts it."""
        memory, last = self.memory, self.memory.frame_from_camera
        if camera is None or last is None or memory.pending is not None:
            return None
        if abs(frame.time_s - memory.time_s) > self._settings.max_prior_s:
            return None
        within_m = reach_m(self.memory, frame.time_s)
        seen = self._own_views.find_lost(frame.gray, camera, last, within_m)
        return None if seen is None else Returned(None, seen, camera)

    def _near_last(
        self,
        frame: TrackingFrame,
        camera: Camera | None,
        predicted: Pose | None,
        surroundings: Surroundings,
    ) -> Fix | None:
        """Return a fix near the last place that can be true."""
        if camera is None or predicted is None or self.memory.frame_id != WORLD:
            return None
        within_m = reach_m(self.memory, frame.time_s)
        fix = surroundings.source.nearby(frame, camera, predicted, within_m)
        if fix is None or not is_inside(fix, surroundings):
            return None
        return fix if is_plausible(self.memory, fix, predicted, frame.time_s) else None

    def _just_searched(self, time_s: float) -> bool:
        """Whether a camera that has been lost for a while was searched for everywhere a moment ago."""
        memory, settings = self.memory, self._settings
        if memory.last is None or memory.pending is not None:
            return False
        is_lost = abs(time_s - memory.time_s) > settings.max_eager_s
        return is_lost and abs(time_s - self._searched_s) < settings.search_every_s

    # What follows from it.

    def _go_on(self, event: Followed, frame: TrackingFrame) -> Tracked:
        """Answer with odometry's pose."""
        odometry, memory, step = self._odometry, self.memory, event.step
        assert odometry is not None  # noqa: S101 - it made the step
        accuracy = accuracy_after(memory, step)
        unaided_m, unaided_rad = unaided(memory, step)
        placed = PlacedPose(self._learn(odometry, event.camera), memory.frame_id)
        self.memory = replace(
            self.memory,
            state="tracking",
            last=placed,
            time_s=frame.time_s,
            unaided_m=unaided_m,
            unaided_rad=unaided_rad,
            pending=None,
        )
        if self._settings.use_own_views:
            self._own_views.keep(frame.gray, event.camera, self.memory, accuracy, odometry.points)
        return self._by_odometry(accuracy, step.support)

    def _come_back(self, event: Returned, frame: TrackingFrame) -> Tracked:
        """Answer with the pose by an earlier view of the session, and let odometry go on from it."""
        seen, step = event.seen, event.step
        if self._odometry is None:
            self._odometry = Odometry(frame, seen.as_fix(event.camera), self._own_lens())
        else:
            self._odometry.move_to(seen.pose)
        pose = self._learn(self._odometry, event.camera)
        self._own_views.drop_after(seen.view)
        self.memory = seen.memory_at(pose, self.memory, frame.time_s)
        answer = self._by_odometry(seen.accuracy, seen.support)
        if step is None:
            return replace(answer, state="relocalized")
        return replace(answer, by_odometry=step.frame_from_camera, seen_again=seen)

    def _by_odometry(self, accuracy: Accuracy, support: Support) -> Tracked:
        """Answer with the place that is remembered, to which odometry has led."""
        whole = accuracy.with_more(self.memory.camera_sigma)
        return Tracked(
            state="tracking",
            placed=self.memory.last,
            method="odometry",
            accuracy=whole,
            confidence=confidence_of_sigma(whole),
            support=support,
            unaided_m=self.memory.unaided_m,
            camera=self.camera,
        )

    def _join(self, event: Corrected, frame: TrackingFrame) -> Tracked:
        """Believe a fix near odometry's place; where the scales of both may be wrong, what they have in common."""
        assert self._odometry is not None  # noqa: S101 - it made the step
        joined = at_scale_of_both(self._odometry, event, self.memory)
        if joined is None:
            return self._doubt(Doubted(event.fix, event.fix.camera), frame)
        fix, rescaled = joined
        return self._take(fix, frame, "tracking", rescaled=rescaled)

    def _take(self, fix: Fix, frame: TrackingFrame, state: State, rescaled: bool = False) -> Tracked:
        """Believe a fix, and let odometry go on from it."""
        if self.camera is None:
            self.camera = fix.camera.scaled_to(frame.rgb.shape[1], frame.rgb.shape[0])
        if self._odometry is None or (fix.scale_sigma > 0.0 and not rescaled):
            # What odometry placed by itself has the scale of the last fix.
            self._odometry = Odometry(frame, fix, self._own_lens())
        elif not rescaled:
            self._odometry.absorb(fix)
        self._learn(self._odometry, fix.camera)
        self._own_views = OwnViews()
        self._since_refresh = self._since_search = 0
        self.memory = TrackingMemory(
            state=state,
            last=fix.placed,
            time_s=frame.time_s,
            fix_accuracy=fix.accuracy,
            fix_scale_sigma=fix.scale_sigma,
            lens=self.memory.lens,
            camera_sigma=fix.camera_sigma or self.memory.camera_sigma,
        )
        return Tracked(
            state=state,
            placed=fix.placed,
            method=fix.method,
            accuracy=fix.accuracy.with_more(self.memory.camera_sigma),
            confidence=fix.confidence,
            support=fix.support,
            unaided_m=0.0,
            camera=self.camera,
            fix=fix,
        )

    def _learn(self, odometry: Odometry, camera: Camera) -> Pose:
        """Let odometry adjust its keyframes and the lens; return the pose that it has then."""
        pose = odometry.learn(camera)
        if odometry.lens is not None:
            self.memory = replace(self.memory, lens=(odometry.lens.coefficient, odometry.lens.sigma))
        return pose

    def _doubt(self, event: Doubted, frame: TrackingFrame) -> Tracked:
        """Remember a fix that the camera can't have come to, and answer that it is lost."""
        fix, self._odometry = event.fix, None
        self.memory = replace(self.memory, state="lost", pending=fix.placed, pending_time_s=frame.time_s)
        return self._nothing("lost", Unseen("ambiguous", fix.support, event.camera))

    def _miss(self, event: Unseen, frame: TrackingFrame) -> Tracked:
        """Answer that the camera was not found; what waited too long for confirmation is dropped."""
        memory, self._why_lost = self.memory, event.reason
        state: State = "initializing" if memory.last is None else "lost"
        expired = abs(frame.time_s - memory.pending_time_s) > BELIEF.max_confirmation_s
        self.memory = replace(memory, state=state, pending=None if expired else memory.pending)
        return self._nothing(state, event)

    def _nothing(self, state: State, event: Unseen) -> Tracked:
        return Tracked(
            state=state,
            reason=event.reason,
            support=event.support,
            unaided_m=self.memory.unaided_m,
            camera=event.camera,
        )
