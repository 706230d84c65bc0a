"""One moving camera: fixes, odometry between them, and what may be believed of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.query.verification import Reason
from app.engine.tracking.drift import JERK_M, MAX_FREE_M, MAX_SPEED_M_S, reach_m, sigma_of, unaided
from app.engine.tracking.fix import WORLD, Fix, FixSource, NoFix, confidence_of_sigma
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.odometry import Odometry, OdometryStep
from app.engine.tracking.state import State, TrackingMemory
from app.engine.tracking.tracked import Tracked, nothing_tracked
from app.engine.tracking.two_view_fix import TrackedPlace, at_common_scale
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m

# A storey: a change of height that no step explains.
MAX_CLIMB_M = 1.2
# After so long without a frame nothing can be followed from the one before.
MAX_GAP_S = 1.0
# Until the scale is known to this share, anchors are asked every so many frames, and from then on every so many.
WANTED_SCALE_SIGMA, SCALE_EVERY, KNOWN_SCALE_EVERY = 0.04, 4, 8
# With a scale known worse than to this share odometry isn't believed for longer than so many metres.
MAX_SCALE_SIGMA, UNSCALED_M = 0.05, 0.2
# After such a path or such turns points are looked for in the map, however few frames it took: odometry drifts by
# what it moves.
REFRESH_M, REFRESH_RAD = 0.3, 0.35
# For so long a camera is looked for near where it was before it is looked for everywhere.
MAX_NEARBY_S = 3.0
# Who is lost for longer than the first is looked for everywhere only so often: it takes many times as long as
# tracking, and frames that soon after each other show the same.
MAX_EAGER_S, SEARCH_EVERY_S = 2.0, 0.45
# A fix corrects odometry by so much beyond three sigmas; by more, one of both is wrong.
MAX_CORRECTION_M = 0.25
# So far from odometry a place that the map shows is looked at at all.
MAX_ASTRAY_M = 1.0
# Two fixes that confirm each other are at most so long apart.
MAX_CONFIRMATION_S = 5.0
# Where places look alike, so long after a camera was seen the one nearer to it is meant; and so long another place,
# out of reach or on another floor, isn't believed at all: from one look-alike all frames confirm each other.
MAX_PRIOR_S, MIN_AWAY_S = 30.0, 10.0
# Where odometry's answers end.
MAX_SIGMA_M = 1.0
# A phone's own odometry and ours agree on a step within this and this share of it.
MOTION_SLACK_M, MOTION_SHARE = 0.15, 0.5


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """How often points are looked for in the map around the pose, and, where that shows nothing, everywhere; in
    frames. Without `use_refresh` the map around the pose is left alone, which is how odometry is measured; without
    `use_relocation` the map isn't used at all after the first fix."""

    refresh_every: int = 4
    relocalize_every: int = 30
    use_refresh: bool = True
    use_relocation: bool = True


@dataclass(slots=True)
class Tracker:
    """Tracks one camera through its frames, one at a time.

    `memory` may come from an earlier process: without the points of its last frame, the next one is located
    anew, and believed at once only near where the camera was. `is_inside` says of a pose in the world whether a
    camera can be there, `can_change_floor` whether one that was there so many seconds ago may be on another floor.
    """

    source: FixSource
    memory: TrackingMemory = field(default_factory=TrackingMemory)
    settings: TrackerSettings = field(default_factory=TrackerSettings)
    camera: Camera | None = None
    is_inside: Callable[[Pose], bool] = lambda _: True
    can_change_floor: Callable[[Pose, float], bool] = lambda *_: False
    _odometry: Odometry | None = None
    _since_refresh: int = 0
    _since_search: int = 0
    _searched_s: float = -1e9
    _why_lost: Reason = "no_match"

    def process(self, frame: TrackingFrame, camera: Camera | None, motion: Pose | None = None) -> Tracked:
        """Answer for a frame. `camera` is the one of the image as it came; without it the one that an earlier
        frame's search found is used, or it is searched for.

        `motion` is the phone's own odometry: this frame's camera in the axes of the previous one, metres. Raises
        `InvalidCameraError` for a camera that can't be the frame's.
        """
        if camera is not None:
            self.camera = camera
        tracked = self._tracking_camera(frame)
        predicted = self._predicted(motion)
        step = self._follow(frame, tracked, predicted, motion)
        self._since_refresh += 1
        self._since_search += 1
        if step is None or tracked is None:
            return self._search(frame, tracked, predicted)
        return self._go_on(frame, tracked, step)

    def forget(self, memory: TrackingMemory) -> None:
        """Go back to an earlier memory: the last frame never was."""
        self.memory, self._odometry = memory, None

    def _tracking_camera(self, frame: TrackingFrame) -> Camera | None:
        if self.camera is None:
            return None
        camera = frame.scaled(self.camera)
        return camera if self._stated_lens() else Lens(*self.memory.lens).of(camera)

    def _stated_lens(self) -> bool:
        """Whether the camera's distortion is known: only a pinhole's lens is learned from its frames."""
        return self.camera is None or self.camera.model != "PINHOLE"

    def _predicted(self, motion: Pose | None) -> Pose | None:
        last = self.memory.world_from_camera
        return last if last is None or motion is None else last @ motion

    def _follow(
        self, frame: TrackingFrame, camera: Camera | None, predicted: Pose | None, motion: Pose | None
    ) -> OdometryStep | None:
        """Return odometry's step to a frame if it can be trusted."""
        odometry, memory = self._odometry, self.memory
        if odometry is None or camera is None or predicted is None or memory.world_from_camera is None:
            return None
        if odometry.size_px != frame.size_px or abs(frame.time_s - memory.time_s) > MAX_GAP_S:
            return None
        step = odometry.step(frame, camera, predicted)
        if step is None or not step.can_be_trusted or not self._is_inside(step.world_from_camera):
            return None
        moved_m = position_difference_m(step.world_from_camera, memory.world_from_camera)
        if moved_m > JERK_M + MAX_SPEED_M_S * max(frame.time_s - memory.time_s, 0.0):
            return None
        if motion is not None:
            off_m = position_difference_m(step.world_from_camera, predicted)
            if off_m > MOTION_SLACK_M + MOTION_SHARE * float(np.linalg.norm(motion.translation)):
                return None
        unscaled = memory.fix_scale_sigma > MAX_SCALE_SIGMA and unaided(memory, step)[0] > UNSCALED_M
        return None if unscaled or sigma_of(memory, step)[0] > MAX_SIGMA_M else step

    def _is_inside(self, pose: Pose) -> bool:
        return self.memory.frame_id != WORLD or self.is_inside(pose)

    def _go_on(self, frame: TrackingFrame, camera: Camera, step: OdometryStep) -> Tracked:
        """Answer with odometry's pose, or with a fix near it when one is due and there."""
        memory, settings = self.memory, self.settings
        assert memory.world_from_camera is not None and self._odometry is not None  # noqa: S101, PT018 - followed
        unaided_m, unaided_rad = unaided(memory, step)
        position_m, orientation_deg = sigma_of(self.memory, step)
        fix = self._refreshed(frame, camera, step, unaided_m, unaided_rad)
        if fix is None and settings.use_relocation and self._since_search >= self._search_every():
            self._since_search = 0
            found = self.source.locate(frame, camera, step.world_from_camera)
            fix = found if isinstance(found, Fix) else None
        if fix is None:
            pose = self._learn(self._odometry, camera)
            step = replace(step, world_from_camera=pose)
            self.memory = replace(
                self.memory,
                state="tracking",
                world_from_camera=pose,
                time_s=frame.time_s,
                unaided_m=unaided_m,
                unaided_rad=unaided_rad,
                pending=None,
            )
            return self._answer("tracking", step, position_m, orientation_deg)
        self._since_search = 0
        off_m = position_difference_m(fix.world_from_camera, step.world_from_camera)
        if fix.frame_id == memory.frame_id and off_m <= MAX_CORRECTION_M + 3.0 * float(
            np.hypot(position_m, fix.position_m)
        ):
            place = TrackedPlace(step.world_from_camera, position_m, orientation_deg, memory.fix_scale_sigma)
            return self._take_by_both(fix, place, frame)
        # The map says that odometry went astray. Neither is believed until a second fix agrees.
        self._odometry = None
        return self._doubt(fix, frame, camera)

    def _take_by_both(self, fix: Fix, place: TrackedPlace, frame: TrackingFrame) -> Tracked:
        """Believe a fix near odometry's place; where both have scales that may be off, what they have in common."""
        odometry = self._odometry
        if odometry is None or fix.scale_sigma <= 0 or place.scale_sigma <= 0:
            return self._take(fix, frame, "tracking")
        ratio = odometry.distance_ratio(fix)
        if ratio is None:
            return self._take(fix, frame, "tracking")
        common = at_common_scale(fix, place, ratio)
        if common is None:
            self._odometry = None
            return self._doubt(fix, frame, fix.camera)
        seen, (fix, factor) = fix.seen, common
        sigma = odometry.adjust_with(fix, ratio)
        if sigma is not None and seen is not None:
            turn = fix.world_from_camera.rotation @ place.world_from_camera.rotation.T
            beside = odometry.beside_monitor(seen.world_from_camera.translation, turn)
            fix, factor = replace(fix, world_from_camera=beside, scale_sigma=sigma), 1.0
        odometry.rescale(factor, fix.world_from_camera)
        return self._take(fix, frame, "tracking", rescaled=True)

    def _learn(self, odometry: Odometry, camera: Camera) -> Pose:
        pose = odometry.learn(camera)
        if odometry.lens is not None:
            self.memory = replace(self.memory, lens=(odometry.lens.coefficient, odometry.lens.sigma))
        return pose

    def _search_every(self) -> int:
        """Return after how many frames map or anchor are asked again: soon while the scale rests on an anchor."""
        sigma, every = self.memory.fix_scale_sigma, self.settings.relocalize_every
        if sigma <= 0.0:
            return every
        return min(SCALE_EVERY if sigma > WANTED_SCALE_SIGMA else KNOWN_SCALE_EVERY, every)

    def _refreshed(
        self, frame: TrackingFrame, camera: Camera, step: OdometryStep, unaided_m: float, unaided_rad: float
    ) -> Fix | None:
        """Return the map's fix around odometry's pose when one is due: by frames, by path or by turns."""
        settings = self.settings
        if not (settings.use_refresh and settings.use_relocation) or self.memory.frame_id != WORLD:
            return None
        moved = unaided_m >= REFRESH_M or unaided_rad >= REFRESH_RAD
        if self._since_refresh < settings.refresh_every and not moved:
            return None
        self._since_refresh = 0
        pose = step.world_from_camera
        fix = self.source.refresh(frame, camera, pose)
        if fix is not None or not moved:
            return fix
        return self.source.nearby(frame, camera, pose, MAX_ASTRAY_M + 3.0 * sigma_of(self.memory, step)[0])

    def _search(self, frame: TrackingFrame, camera: Camera | None, predicted: Pose | None) -> Tracked:
        """Answer by a fix alone."""
        memory = self.memory
        self._odometry = None
        self._since_search = self._since_refresh = 0
        away_s = abs(frame.time_s - memory.time_s)
        is_closed = memory.world_from_camera is not None and not self.settings.use_relocation
        near = None if is_closed or away_s > MAX_NEARBY_S else self._near_last(frame, camera, predicted)
        if near is not None:
            return self._take(near, frame, "relocalized" if memory.state == "lost" else "tracking")
        if is_closed or self._just_searched(frame.time_s):
            self.memory = replace(memory, state="lost")
            return nothing_tracked("lost", self._why_lost, 0, 0, camera, memory)
        self._searched_s = frame.time_s
        prior = predicted if away_s <= MAX_PRIOR_S else None
        found = self.source.locate(frame, camera, prior, self._may_be_elsewhere(frame.time_s))
        if isinstance(found, Fix) and not self._can_be(found):
            found = NoFix("outside_venue", found.inliers, found.matches)
        if isinstance(found, NoFix):
            self._why_lost = found.reason
            state: State = "initializing" if memory.world_from_camera is None else "lost"
            expired = abs(frame.time_s - memory.pending_time_s) > MAX_CONFIRMATION_S
            self.memory = replace(memory, state=state, pending=None if expired else memory.pending)
            return nothing_tracked(state, found.reason, found.inliers, found.matches, camera, memory)
        if memory.world_from_camera is None or predicted is None:
            return self._take(found, frame, "tracking")
        if self._is_plausible(found, predicted, frame.time_s) or self._is_confirmed(found, frame.time_s):
            return self._take(found, frame, "relocalized")
        return self._doubt(found, frame, camera)

    def _just_searched(self, time_s: float) -> bool:
        """Whether somebody who has been lost for a while was looked for everywhere a moment ago."""
        memory = self.memory
        if memory.world_from_camera is None or memory.pending is not None:
            return False
        is_lost = abs(time_s - memory.time_s) > MAX_EAGER_S
        return is_lost and abs(time_s - self._searched_s) < SEARCH_EVERY_S

    def _near_last(self, frame: TrackingFrame, camera: Camera | None, predicted: Pose | None) -> Fix | None:
        """Return a fix near the last place that can be true."""
        if camera is None or predicted is None or self.memory.frame_id != WORLD:
            return None
        fix = self.source.nearby(frame, camera, predicted, reach_m(self.memory, frame.time_s))
        can_be = fix is not None and self._can_be(fix) and self._is_plausible(fix, predicted, frame.time_s)
        return fix if can_be else None

    def _can_be(self, fix: Fix) -> bool:
        return fix.frame_id != WORLD or self.is_inside(fix.world_from_camera)

    def _is_plausible(self, fix: Fix, predicted: Pose, time_s: float) -> bool:
        """Whether the camera can have come from its last place to a fix in the time between."""
        memory = self.memory
        if fix.frame_id != memory.frame_id:
            return False
        offset = fix.world_from_camera.translation - predicted.translation
        within_m = reach_m(memory, time_s, fix.position_m)
        return float(np.linalg.norm(offset)) <= within_m and abs(float(offset[2])) <= MAX_CLIMB_M

    def _is_confirmed(self, fix: Fix, time_s: float) -> bool:
        """Whether the fix agrees with the one that waits for confirmation."""
        memory = self.memory
        waited_s = time_s - memory.pending_time_s
        if memory.pending is None or fix.frame_id != memory.pending_frame_id:
            return False
        if not 0.0 <= waited_s <= MAX_CONFIRMATION_S:
            return False
        apart_m = position_difference_m(fix.world_from_camera, memory.pending)
        turned_rad = attitude_difference_rad(fix.world_from_camera, memory.pending)
        agrees = apart_m <= JERK_M + MAX_SPEED_M_S * waited_s and turned_rad <= np.pi / 6 + np.pi * waited_s
        is_far_away = abs(time_s - memory.time_s) >= MIN_AWAY_S or self._may_be_elsewhere(time_s)
        return agrees and (self._is_near(fix) or is_far_away)

    def _may_be_elsewhere(self, time_s: float) -> bool:
        """Whether the camera may have left the floor where it was seen last."""
        memory = self.memory
        if memory.world_from_camera is None or memory.frame_id != WORLD:
            return False
        return self.can_change_floor(memory.world_from_camera, abs(time_s - memory.time_s))

    def _is_near(self, fix: Fix) -> bool:
        """Whether a fix is on the floor where the camera was last, and no look-alike place elsewhere."""
        memory = self.memory
        if memory.world_from_camera is None or fix.frame_id != memory.frame_id:
            return True
        offset = fix.world_from_camera.translation - memory.world_from_camera.translation
        return float(np.linalg.norm(offset)) <= MAX_FREE_M and abs(float(offset[2])) <= MAX_CLIMB_M

    def _doubt(self, fix: Fix, frame: TrackingFrame, camera: Camera | None) -> Tracked:
        """Remember a fix that nothing leads to, and answer that the camera is lost."""
        self.memory = replace(
            self.memory,
            state="lost",
            pending=fix.world_from_camera,
            pending_frame_id=fix.frame_id,
            pending_time_s=frame.time_s,
        )
        return nothing_tracked("lost", "ambiguous", fix.inliers, fix.matches, camera, self.memory)

    def _take(self, fix: Fix, frame: TrackingFrame, state: State, rescaled: bool = False) -> Tracked:
        """Believe a fix, and let odometry go on from it."""
        if self.camera is None:
            self.camera = fix.camera.scaled_to(frame.rgb.shape[1], frame.rgb.shape[0])
        if self._odometry is None or (fix.scale_sigma > 0.0 and not rescaled):
            # What odometry placed by itself has the scale of the last fix.
            self._odometry = Odometry(frame, fix, None if self._stated_lens() else Lens(*self.memory.lens))
        elif not rescaled:
            self._odometry.absorb(fix)
        self._learn(self._odometry, fix.camera)
        self._since_refresh = self._since_search = 0
        self.memory = TrackingMemory(
            state,
            fix.world_from_camera,
            fix.frame_id,
            frame.time_s,
            fix.position_m,
            fix.orientation_deg,
            fix.scale_sigma,
            lens=self.memory.lens,
        )
        return Tracked(
            state,
            fix.world_from_camera,
            None,
            fix.method,
            fix.frame_id,
            fix.position_m,
            fix.orientation_deg,
            fix.confidence,
            fix.inliers,
            fix.matches,
            0.0,
            self.camera,
            fix,
        )

    def _answer(self, state: State, step: OdometryStep, position_m: float, orientation_deg: float) -> Tracked:
        return Tracked(
            state,
            step.world_from_camera,
            None,
            "odometry",
            self.memory.frame_id,
            position_m,
            orientation_deg,
            confidence_of_sigma(position_m, orientation_deg),
            step.inliers,
            step.matches,
            self.memory.unaided_m,
            self.camera,
        )
