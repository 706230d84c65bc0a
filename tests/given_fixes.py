"""Trackers whose frames are blank, so that nothing can be followed and each answer rests on a fix that a test gives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from app.engine.query.placed import WORLD, Accuracy, PlacedPose, Support
from app.engine.query.verification import Reason
from app.engine.tracking.fix import Fix, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.state import State, TrackingMemory
from app.engine.tracking.tracked import Tracked
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from tests.scenes import CAMERA, pose_at
from tests.tracking import TrackerIn

BLANK = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)
HOME = pose_at(0.0, 0.0)
PLACE = PlacedPose(HOME)
PLAN = "plan:ground"
NOTHING = NoFix("no_match", Support(3, 7))


def fix_at(
    x: float = 0.0, y: float = 0.0, climb_m: float = 0.0, yaw_deg: float = 0.0, frame_id: str = WORLD
) -> Fix:
    """Return a fix that is sure of itself."""
    pose = pose_at(x, y, HOME.translation[2] + climb_m, yaw_deg)
    empty = np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0)
    return Fix(
        placed=PlacedPose(pose, frame_id),
        accuracy=Accuracy(0.0, 0.5),
        support=Support(40, 50),
        confidence=0.9,
        points_px=empty[0],
        points_in_frame=empty[1],
        point_sigma_m=empty[2],
        camera=CAMERA,
    )


@dataclass
class Seen:
    """Gives the fixes that a test says are seen, and keeps where the camera was looked for."""

    everywhere: Fix | NoFix = NOTHING
    around: Fix | None = None
    asked_near: list[Pose | None] = field(default_factory=list)
    asked_any_floor: list[bool] = field(default_factory=list)
    reaches_m: list[float] = field(default_factory=list)

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False
    ) -> Fix | NoFix:
        self.asked_near.append(near)
        self.asked_any_floor.append(any_floor)
        return self.everywhere

    def refresh(self, frame: TrackingFrame, camera: Camera, predicted: Pose) -> Fix | None:
        return None

    def nearby(self, frame: TrackingFrame, camera: Camera, near: Pose, reach_m: float) -> Fix | None:
        self.reaches_m.append(reach_m)
        return self.around


def remembered(
    last: PlacedPose | None = PLACE, state: State = "tracking", sigma_m: float = 0.0
) -> TrackingMemory:
    """Return the memory of a camera that was at a place at 100 s."""
    return TrackingMemory(state=state, last=last, time_s=100.0, fix_accuracy=Accuracy(sigma_m, 0.0))


AT_HOME = remembered()


def at(tracker: TrackerIn, time_s: float, seen: Fix | NoFix | None = None) -> Tracked:
    """Return the answer to a blank frame, in which `seen` is seen."""
    source = tracker.surroundings.source
    assert isinstance(source, Seen)
    if seen is not None:
        source.everywhere = seen
    return tracker.process(TrackingFrame.of(BLANK, time_s), CAMERA)


def assert_lost(tracked: Tracked, reason: Reason) -> None:
    assert (tracked.state, tracked.reason, tracked.placed) == ("lost", reason, None)


def doubted(fix: Fix, time_s: float = 100.1) -> TrackerIn:
    """Return a tracker that has seen a fix once, out of reach."""
    tracker = TrackerIn(Seen(), AT_HOME)
    assert_lost(at(tracker, time_s, fix), "ambiguous")
    return tracker
