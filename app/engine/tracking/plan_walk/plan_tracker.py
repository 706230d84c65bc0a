"""A tracker for venues without a map: anchors give rare fixes, odometry and the floor plan all that is between."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSearch, AroundPlace
from app.engine.floors.plan_distances import distances_by_plan
from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.tracking.fix import Fix, NoFix, confidence_of_sigma
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.plan_walk.motion import PlanOdometry, yaw_of
from app.engine.tracking.plan_walk.options import OPTIONS
from app.engine.tracking.plan_walk.particles import Particles, PlanBelief, PlanFix
from app.engine.tracking.plan_walk.plans import PlanFloor, Plans
from app.engine.tracking.plan_walk.trust import PlaceTrust
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.state import State, TrackingMemory
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracked import Tracked
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Pending:
    """A fix that contradicts what was believed, as the particles of its own that it would start."""

    fix: PlanFix
    frame_id: str
    particles: Particles
    time_s: float


@dataclass(frozen=True, slots=True)
class _Corrected:
    """The anchors of a fix that corrected the particles, and its place (2,)."""

    anchors: tuple[str, ...]
    xy: Array


class PlanTracker:
    """Tracks one camera through its frames on floor plans, one at a time. Memory and camera as in `Tracker`."""

    def __init__(self, memory: TrackingMemory | None = None, settings: TrackerSettings | None = None) -> None:
        self.memory = memory or TrackingMemory()
        self.camera: Camera | None = None
        self._settings = settings or TrackerSettings()
        self._odometry = PlanOdometry()
        self._trust = PlaceTrust()
        self._particles: Particles | None = None
        self._pending: _Pending | None = None
        self._corrected: _Corrected | None = None
        self._frame_id = self.memory.frame_id
        self._height_m = OPTIONS.height_m
        self._since_search = OPTIONS.sure_every
        self._searches = 0
        self._is_begun = False
        self._has_fix = self.memory.last is not None

    def forget(self, memory: TrackingMemory) -> None:
        """Go back to an earlier memory: the last frame never was."""
        self.memory, self._particles, self._pending, self._is_begun = memory, None, None, False
        self._trust = PlaceTrust()

    def process(self, frame: TrackingFrame, surroundings: Surroundings) -> Tracked:
        """Answer for a frame: particles are moved by odometry, weighted by a fix, and their mean is the place."""
        plans = surroundings.plans
        self.camera = frame.camera or self.camera
        if self.camera is None or plans is None:
            return self._nothing(NoFix("no_match"))
        camera = frame.scaled(self.camera)
        self._resume(frame, plans)
        support = Support()
        if self._particles is not None:
            motion = self._odometry.motion(frame, camera)
            self._particles.move(motion)
            self._trust.moved(self._odometry.unseen_s)
            if self._pending is not None:
                self._pending.particles.move(motion)
            support = Support() if self._odometry.step is None else self._odometry.step.support
        before = None if self._particles is None else self._particles.belief()
        found = self._fix(frame, camera, before, surroundings)
        state: State = "tracking"
        fix = found if isinstance(found, Fix) else None
        known = self._particles
        if fix is not None:
            state = self._believe(fix, frame, plans)
            support = fix.support
        elif isinstance(found, NoFix) and found.is_contested:
            self._contest()
        if self._particles is None or state == "lost":
            reason = (
                found if isinstance(found, NoFix) else NoFix("ambiguous" if fix is not None else "no_match")
            )
            self._learn(frame, camera, plans, fix if self._particles is not known else None)
            return self._nothing(reason)
        self._learn(frame, camera, plans, fix)
        belief = self._particles.belief()
        if belief.position_sigma_m > OPTIONS.lost_sigma_m:
            self._particles = None
        if not self._trust.may_answer(belief, _accuracy(belief)):
            return self._nothing(NoFix("no_match"))
        return self._answer(frame, plans, belief, support, fix, state, before)

    # What is asked and believed.

    def _fix(
        self, frame: TrackingFrame, camera: Camera, belief: PlanBelief | None, surroundings: Surroundings
    ) -> Fix | NoFix | None:
        """Return the anchors' fix when one is due, None when none is."""
        self._since_search += 1
        anchors = surroundings.anchors
        if anchors is None:
            return NoFix("no_map")
        is_known = belief is not None and self._trust.is_known(belief, _accuracy(belief))
        if (self._has_fix and not self._settings.use_relocation) or (
            is_known and not self._settings.use_refresh
        ):
            return None
        is_sure = is_known and belief is not None and belief.position_sigma_m <= OPTIONS.sure_sigma_m
        if self._since_search < (OPTIONS.sure_every if is_sure else OPTIONS.unsure_every):
            return None
        self._since_search = 0
        self._searches += 1
        plans, around = surroundings.plans, None
        # Far from the last fix all anchors are asked now and then, as the place itself may be that of a look-alike.
        is_doubtful = (
            self.memory.unaided_m > OPTIONS.doubtful_m and self._searches % OPTIONS.everywhere_every == 0
        )
        if is_known and belief is not None and plans is not None and not is_doubtful:
            around = self._around(belief, plans, camera)
        search = AnchorSearch(around=around, to_be_confirmed=not is_known)
        return anchors.locate(frame, camera, None, search=search)

    def _around(self, belief: PlanBelief, plans: Plans, camera: Camera) -> AroundPlace:
        """Return what the camera may see from the place that is believed."""
        upright = self._odometry.upright.levelled @ self._odometry.pose.rotation
        half_view_deg = float(np.degrees(np.arctan2(0.5 * camera.width, camera.focal_px)))
        return plans.around(
            self._pose_at(belief, plans.by_id[belief.floor], upright),
            belief.floor,
            phone_m=OPTIONS.fix_reach_m + 3.0 * belief.position_sigma_m,
            half_view_deg=half_view_deg + 3.0 * float(np.degrees(belief.yaw_sigma_rad)),
            sees_m=OPTIONS.anchor_reach_m,
        )

    def _believe(self, fix: Fix, frame: TrackingFrame, plans: Plans) -> State:
        """Correct the particles by a fix; one that contradicts them waits for a second that agrees.

        Where there are none, or their place is lost, it begins particles whose place is not answered until then.
        """
        floor, pose = plans.floor_of(fix.placed), fix.frame_from_camera
        if floor is None:
            return "lost" if self._particles is None else "tracking"
        seen = PlanFix(
            floor=floor.id,
            xy=pose.translation[:2],
            yaw_rad=yaw_of(pose.rotation),
            position_sigma_m=fix.accuracy.position_m,
            yaw_sigma_rad=float(np.radians(fix.accuracy.orientation_deg)),
        )
        if self._particles is not None and fix.frame_id == self._frame_id and _agrees(self._particles, seen):
            is_found = self._trust.is_lost and self.memory.last is not None
            self._correct(self._particles, seen, fix.anchors)
            self._trust.found()
            self._note_height(pose, floor)
            self._pending, self._has_fix = None, True
            return "relocalized" if is_found else "tracking"
        if self._is_confirmed(seen, fix.frame_id, frame.time_s):
            self._begin(seen, fix, floor, plans, frame)
            self._trust.found()
            self._pending, self._has_fix = None, True
            return "tracking" if self.memory.last is None else "relocalized"
        if self._particles is None or self._trust.is_lost:
            self._begin(seen, fix, floor, plans, frame)
            self._trust.begun()
            return "lost"
        self._pending = _Pending(
            seen,
            fix.frame_id,
            Particles(plans.walls_in(fix.frame_id), seen),
            frame.time_s,
        )
        return "lost"

    def _correct(self, particles: Particles, seen: PlanFix, anchors: tuple[str, ...]) -> None:
        """Correct particles by a fix, but for one that says nothing new.

        Pictures of the same cameras from one place err alike: however many there are, they make the place no surer than
        one of them does.
        """
        before = self._corrected
        is_again = (
            before is not None
            and before.anchors == anchors
            and bool(np.linalg.norm(before.xy - seen.xy) < OPTIONS.same_place_m)
        )
        if is_again and particles.belief().position_sigma_m <= seen.position_sigma_m:
            return
        particles.correct(seen)
        if not is_again:
            self._corrected = _Corrected(anchors, seen.xy)

    def _contest(self) -> None:
        """Forget a fix that waits for a second one: two places look like what is seen, and it was of one of them."""
        self._pending = None
        if self._trust.is_by_one_fix:
            self._particles, self._trust = None, PlaceTrust()

    def _begin(self, seen: PlanFix, fix: Fix, floor: PlanFloor, plans: Plans, frame: TrackingFrame) -> None:
        """Begin at a fix. What odometry followed had its scale by another place."""
        self._odometry.start(frame, fix.frame_from_camera)
        self._particles, self._frame_id = Particles(plans.walls_in(fix.frame_id), seen), fix.frame_id
        self._corrected = _Corrected(fix.anchors, seen.xy)
        self._note_height(fix.frame_from_camera, floor)

    def _is_confirmed(self, seen: PlanFix, frame_id: str, time_s: float) -> bool:
        """Whether a fix agrees with the one that waits, moved as the camera has moved since."""
        pending = self._pending
        if (
            pending is None
            or pending.frame_id != frame_id
            or time_s - pending.time_s > OPTIONS.confirmation_s
        ):
            return False
        there = pending.particles.belief()
        away_m = float(np.linalg.norm(there.xy - seen.xy))
        within_m = OPTIONS.confirmation_m + 3.0 * float(
            np.hypot(there.position_sigma_m, seen.position_sigma_m)
        )
        return there.floor == seen.floor and away_m <= within_m

    def _note_height(self, pose: Pose, floor: PlanFloor) -> None:
        height_m = float(pose.translation[2]) - floor.zero_m
        if OPTIONS.least_height_m <= height_m <= OPTIONS.most_height_m:
            self._height_m = height_m

    def _resume(self, frame: TrackingFrame, plans: Plans) -> None:
        """Begin at the remembered place after a restart."""
        last, memory = self.memory.last, self.memory
        if self._is_begun or last is None:
            self._is_begun = True
            return
        self._is_begun = True
        away_s = max(frame.time_s - memory.time_s, 0.0)
        sigma_m = float(np.hypot(memory.fix_accuracy.position_m, OPTIONS.resumed_m_s * away_s))
        floor = plans.floor_of(last)
        if floor is None or sigma_m > OPTIONS.lost_sigma_m:
            return
        pose = last.frame_from_camera
        seen = PlanFix(
            floor=floor.id,
            xy=pose.translation[:2],
            yaw_rad=yaw_of(pose.rotation),
            position_sigma_m=sigma_m,
            yaw_sigma_rad=float(
                np.radians(memory.fix_accuracy.orientation_deg + OPTIONS.resumed_deg_s * away_s)
            ),
        )
        self._odometry.start(frame, pose)
        self._particles = Particles(plans.walls_in(last.frame_id), seen)
        self._frame_id = last.frame_id
        self._note_height(pose, floor)

    # What follows from it.

    def _learn(self, frame: TrackingFrame, camera: Camera, plans: Plans, fix: Fix | None) -> None:
        if self._particles is None:
            return
        belief = self._particles.belief()
        floor = plans.by_id[belief.floor]
        expected = partial(self._expected, belief, floor)
        self._odometry.learn(frame, camera, expected, fix, has_walls=floor.walls is not None)

    def _expected(
        self, belief: PlanBelief, floor: PlanFloor, pixels: Array, camera: Camera, pose: Pose
    ) -> Array:
        """Return how far away the plan has what is seen at pixels (n, 2), from the place that is believed."""
        here = self._pose_at(belief, floor, self._odometry.upright.levelled @ pose.rotation)
        return distances_by_plan(pixels, camera, here, floor.zero_m, floor.walls)

    def _pose_at(self, belief: PlanBelief, floor: PlanFloor, upright: Array) -> Pose:
        """Return the pose at a believed place, of a camera whose upright rotation (3, 3) is known but for the yaw."""
        turn = rotation_from_vector(np.array([0.0, 0.0, belief.yaw_rad - yaw_of(upright)]))
        return Pose(turn @ upright, np.array([*belief.xy, floor.zero_m + self._height_m]))

    def _answer(
        self,
        frame: TrackingFrame,
        plans: Plans,
        belief: PlanBelief,
        support: Support,
        fix: Fix | None,
        state: State,
        before: PlanBelief | None,
    ) -> Tracked:
        floor = plans.by_id[belief.floor]
        upright = self._odometry.upright.levelled @ self._odometry.pose.rotation
        placed = PlacedPose(self._pose_at(belief, floor, upright), self._frame_id)
        accuracy = _accuracy(belief)
        moved_m = 0.0
        last = self.memory.last
        if last is not None and last.frame_id == self._frame_id:
            moved_m = float(np.linalg.norm(last.frame_from_camera.translation[:2] - belief.xy))
        unaided_m = 0.0 if fix is not None else self.memory.unaided_m + moved_m
        self.memory = replace(
            TrackingMemory(lens=self.memory.lens),
            state=state,
            last=placed,
            time_s=frame.time_s,
            fix_accuracy=accuracy,
            unaided_m=unaided_m,
        )
        by_odometry = None
        if fix is not None and before is not None and state == "tracking":
            by_odometry = self._pose_at(before, plans.by_id[before.floor], upright)
        return Tracked(
            state=state,
            placed=placed,
            method="odometry" if fix is None else fix.method,
            accuracy=accuracy,
            confidence=confidence_of_sigma(accuracy),
            support=support,
            unaided_m=unaided_m,
            camera=self.camera,
            fix=fix,
            by_odometry=by_odometry,
        )

    def _nothing(self, why: NoFix) -> Tracked:
        state: State = "initializing" if self.memory.last is None else "lost"
        self.memory = replace(self.memory, state=state)
        return Tracked(
            state=state,
            reason=why.reason,
            support=why.support,
            unaided_m=self.memory.unaided_m,
            camera=self.camera,
        )


def _accuracy(belief: PlanBelief) -> Accuracy:
    turn_deg = float(np.degrees(belief.yaw_sigma_rad))
    return Accuracy(belief.position_sigma_m, float(np.hypot(turn_deg, OPTIONS.tilt_sigma_deg)))


def _agrees(particles: Particles, seen: PlanFix) -> bool:
    return particles.share_near(seen, OPTIONS.agreement_sigmas) >= OPTIONS.min_agreeing_share
