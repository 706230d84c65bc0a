"""How a camera moves over the floor from frame to frame, by odometry whose scale is that of the floor plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.tracking.fix import Fix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.odometry.turning import shift_between
from app.engine.tracking.odometry.visual_odometry import ExpectedDistances, Odometry, OdometryStep
from app.engine.tracking.plan_walk.particles import PlanMotion
from app.engine.tracking.plan_walk.rematch import matches_between, pose_by_matches
from app.engine.tracking.plan_walk.two_views import pose_by_two_views
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, position_difference_m, rotation_from_vector
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanMotionOptions:
    """The errors of a step, followed or guessed."""

    step_sigma_m: float = limit(
        0.02, "Sigma of a followed step however short it is.", chosen="By hand: a hand's sway."
    )
    step_sigma_ratio: float = limit(
        0.12,
        "Sigma of a followed step over its length.",
        chosen="Recorded walks of roomfix simulate --no-map.",
    )
    turn_sigma_rad: float = limit(
        0.006,
        "Sigma of a followed turn however small it is.",
        chosen="Recorded walks of roomfix simulate --no-map.",
    )
    turn_sigma_ratio: float = limit(
        0.02, "Sigma of a followed turn over the turn.", chosen="Recorded walks of roomfix simulate --no-map."
    )
    rematched_sigma_ratio: float = limit(
        0.25, "Sigma of a step by matches over its length.", chosen="By hand: distances by the plan alone."
    )
    rematched_turn_sigma_rad: float = limit(0.02, "Sigma of a turn by matches.", chosen="By hand: a degree.")
    max_speed_m_s: float = limit(
        2.0,
        "Fastest that a followed walker goes.",
        chosen="By hand: a fast walk; a pose in error is often farther.",
    )
    leap_m: float = limit(0.2, "A step that a hand's jerk explains.", chosen="By hand: half an arm's swing.")
    pace_m_s: float = limit(1.2, "Pace of a walker who is not followed.", chosen="By hand: a usual pace.")
    blind_sigma_m_s: float = limit(
        0.5, "Sigma of the speed of a walker who is not followed.", chosen="By hand: half a usual pace."
    )
    seen_turn_sigma_rad: float = limit(
        0.25,
        "Sigma of a turn by the shift of the whole picture, which a step towards something near shifts, too.",
        chosen="By hand, with a recorded walk of roomfix simulate --no-map --seed 5: beside bare walls it was wrong by "
        "up to 20 degrees.",
    )
    blind_turn_sigma_rad_s: float = limit(
        0.7, "Sigma of the speed of a turn that nothing shows.", chosen="By hand: 40 degrees a second."
    )
    gravity_weight: float = limit(
        0.1,
        "Weight of a frame's gravity in the vertical of odometry.",
        chosen="By hand: ten frames average the noise of a phone that is carried.",
    )


OPTIONS = PlanMotionOptions()


@dataclass(frozen=True, slots=True)
class Upright:
    """The vertical in odometry's frame, up (3,)."""

    up: Array

    def after(self, pose: Pose, gravity: tuple[float, float, float] | None) -> Upright:
        """Return the vertical after a frame's gravity, down (3,) in camera axes."""
        if gravity is None:
            return self
        seen = -pose.rotation @ np.asarray(gravity, dtype=np.float64)
        seen /= max(float(np.linalg.norm(seen)), 1e-9)
        up = (1.0 - OPTIONS.gravity_weight) * self.up + OPTIONS.gravity_weight * seen
        return Upright(up / np.linalg.norm(up))

    @property
    def levelled(self) -> Array:
        """The rotation (3, 3) that takes the vertical to z."""
        axis = np.cross(self.up, [0.0, 0.0, 1.0])
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            return np.eye(3)
        return rotation_from_vector(axis / length * np.arctan2(length, self.up[2]))


def yaw_of(rotation: Array) -> float:
    """Return the direction of a camera's optical axis about z, radians counter-clockwise from x."""
    return float(np.arctan2(rotation[1, 2], rotation[0, 2]))


class PlanOdometry:
    """Follows a camera in a frame of its own, and starts again where it can't."""

    def __init__(self) -> None:
        self.pose = Pose.identity()
        self.upright = Upright(np.array([0.0, 0.0, 1.0]))
        self._odometry: Odometry | None = None
        self._gray: Gray | None = None
        self._time_s = 0.0
        self._speed_m_s = 0.0
        self._expected: ExpectedDistances | None = None
        self.step: OdometryStep | None = None
        self.unseen_s = 0.0

    def start(self, frame: TrackingFrame, pose: Pose) -> None:
        """Begin at an upright pose; what is followed comes with `learn`."""
        self._odometry, self.pose = None, pose
        self.upright = Upright(np.array([0.0, 0.0, 1.0]))
        self._gray, self._time_s, self._speed_m_s = frame.gray, frame.time_s, 0.0
        self._expected, self.unseen_s = None, 0.0

    def motion(self, frame: TrackingFrame, camera: Camera) -> PlanMotion:
        """Return how the camera moved since the last frame; `step` says how odometry followed it, None where it
        didn't."""
        elapsed_s = max(frame.time_s - self._time_s, 0.0)
        self.step = self._followed(frame, camera, elapsed_s)
        if self.step is not None:
            self.unseen_s = 0.0
            found = self._seen(self.step)
        else:
            seen = self._rematched(frame, camera, elapsed_s)
            is_seen = seen is not None or frame.motion is not None
            self.unseen_s = 0.0 if is_seen else self.unseen_s + elapsed_s
            found = seen or self._blind(frame, camera, elapsed_s)
        self.upright = self.upright.after(self.pose, frame.gravity)
        if elapsed_s > 0.0:
            self._speed_m_s = float(np.linalg.norm(found.moved)) / elapsed_s
        self._gray, self._time_s = frame.gray, frame.time_s
        return found

    def learn(
        self,
        frame: TrackingFrame,
        camera: Camera,
        expected: ExpectedDistances,
        fix: Fix | None,
        has_walls: bool,
    ) -> None:
        """Place new points where the plan has them, and begin to follow again where nothing is followed.

        Points of a `fix` begin it where there are any. Without walls the plan says little, and each fix begins it anew.
        """
        if fix is not None and (self._odometry is None or not has_walls):
            self.start(frame, fix.frame_from_camera)
            self._odometry = Odometry(frame, fix, expected=expected if has_walls else None)
        elif self._odometry is None:
            self._odometry = Odometry(frame, None, pose=self.pose, expected=expected)
        elif has_walls:
            self._odometry.expected = expected
        self._expected = expected
        self.pose = self._odometry.learn(camera)

    def _followed(self, frame: TrackingFrame, camera: Camera, elapsed_s: float) -> OdometryStep | None:
        odometry = self._odometry
        if odometry is None or odometry.size_px != frame.size_px:
            return None
        predicted = self.pose if frame.motion is None else self.pose @ frame.motion
        step = odometry.step(frame, camera, predicted)
        if step is None or not step.can_be_trusted or _is_leap(step.frame_from_camera, self.pose, elapsed_s):
            self._odometry = None
            return None
        return step

    def _rematched(self, frame: TrackingFrame, camera: Camera, elapsed_s: float) -> PlanMotion | None:
        """Return the motion by features of both frames, or None where too few agree."""
        gray, expected = self._gray, self._expected
        if frame.motion is not None or gray is None or expected is None or gray.shape != frame.gray.shape:
            return None
        matches = matches_between(gray, frame.gray)
        if matches is None:
            return None
        pose = pose_by_matches(matches, self.pose, expected, camera)
        if pose is None or _is_leap(pose, self.pose, elapsed_s):
            pose = pose_by_two_views(matches, self.pose, expected, camera)
        if pose is None or _is_leap(pose, self.pose, elapsed_s):
            return None
        moved, turned = self._between(self.pose, pose)
        self.pose = pose
        ratio = OPTIONS.rematched_sigma_ratio * float(np.linalg.norm(moved))
        return PlanMotion(
            moved=moved,
            moved_sigma_m=float(np.hypot(2.0 * OPTIONS.step_sigma_m, ratio)),
            turned_rad=turned,
            turned_sigma_rad=OPTIONS.rematched_turn_sigma_rad,
        )

    def _between(self, before: Pose, after: Pose) -> tuple[Array, float]:
        """Return how far ahead and to the left (2,) a camera moved over the floor, and its turn to the left."""
        level = self.upright.levelled
        yaw = yaw_of(level @ before.rotation)
        offset = level @ (after.translation - before.translation)
        return _turned(offset[:2], -yaw), _angle(yaw_of(level @ after.rotation) - yaw)

    def _seen(self, step: OdometryStep) -> PlanMotion:
        before, self.pose = self.pose, step.frame_from_camera
        moved, turned = self._between(before, self.pose)
        length_m = float(np.linalg.norm(moved))
        own = min(step.accuracy.position_m, 0.5 * length_m)
        sigma = [OPTIONS.step_sigma_m, OPTIONS.step_sigma_ratio * length_m, own]
        return PlanMotion(
            moved=moved,
            moved_sigma_m=float(np.linalg.norm(sigma)),
            turned_rad=turned,
            turned_sigma_rad=float(np.hypot(OPTIONS.turn_sigma_rad, OPTIONS.turn_sigma_ratio * turned)),
        )

    def _blind(self, frame: TrackingFrame, camera: Camera, elapsed_s: float) -> PlanMotion:
        """Return a motion by the phone's own odometry, else by the shift of the picture and a walker's pace."""
        if frame.motion is not None:
            after = self.pose @ frame.motion
            moved, turned = self._between(self.pose, after)
            self.pose = after
            ratio = OPTIONS.step_sigma_ratio * float(np.linalg.norm(moved))
            return PlanMotion(
                moved=moved,
                moved_sigma_m=OPTIONS.step_sigma_m + ratio,
                turned_rad=turned,
                turned_sigma_rad=float(np.hypot(OPTIONS.turn_sigma_rad, OPTIONS.turn_sigma_ratio * turned)),
            )
        same = self._gray is not None and self._gray.shape == frame.gray.shape
        shift_px = shift_between(self._gray, frame.gray) if same and self._gray is not None else None
        turned = 0.0 if shift_px is None else float(np.arctan2(shift_px[0], camera.focal_px))
        unseen_s = (self.unseen_s - elapsed_s, self.unseen_s)
        sigma_rad = (
            _added_sigma(OPTIONS.blind_turn_sigma_rad_s, unseen_s)
            if shift_px is None
            else OPTIONS.seen_turn_sigma_rad
        )
        speed = min(self._speed_m_s, OPTIONS.pace_m_s)
        about = rotation_from_vector(self.upright.up * turned)
        self.pose = Pose(about @ self.pose.rotation, self.pose.translation)
        return PlanMotion(
            moved=np.array([speed * elapsed_s, 0.0]),
            moved_sigma_m=_added_sigma(OPTIONS.blind_sigma_m_s, unseen_s),
            turned_rad=turned,
            turned_sigma_rad=sigma_rad,
        )


def _is_leap(pose: Pose, before: Pose, elapsed_s: float) -> bool:
    """Whether nobody moves as fast as this."""
    return position_difference_m(pose, before) > OPTIONS.leap_m + OPTIONS.max_speed_m_s * elapsed_s


def _added_sigma(sigma_a_second: float, unseen_s: tuple[float, float]) -> float:
    """Return the sigma that a step adds from one time without a seen step to the next: who turns or walks goes on so,
    so that the whole sigma grows with the time, not with its root."""
    before_s, after_s = unseen_s
    return sigma_a_second * float(np.sqrt(max(after_s**2 - before_s**2, 0.0)))


def _angle(radians: float) -> float:
    return float((radians + np.pi) % (2 * np.pi) - np.pi)


def _turned(vector: Array, radians: float) -> Array:
    cos, sin = np.cos(radians), np.sin(radians)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])
