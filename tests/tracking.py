"""A tracker with what it is told about a building, as tests drive it frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from app.engine.tracking.fix import FixSource
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.state import TrackingMemory
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracked import Tracked
from app.engine.tracking.tracker import Tracker
from app.geometry.camera import Camera
from app.geometry.se3 import Pose


class TrackerIn:
    """A tracker in a building whose fixes come from one source."""

    def __init__(
        self,
        source: FixSource,
        memory: TrackingMemory | None = None,
        settings: TrackerSettings | None = None,
        is_inside: Callable[[Pose], bool] = lambda _: True,
        can_change_floor: Callable[[Pose, float], bool] = lambda *_: False,
    ) -> None:
        self.tracker = Tracker(memory, settings)
        self.surroundings = Surroundings(source, is_inside, can_change_floor)

    @property
    def memory(self) -> TrackingMemory:
        """What the tracker remembers."""
        return self.tracker.memory

    def process(self, frame: TrackingFrame, camera: Camera | None, motion: Pose | None = None) -> Tracked:
        """Answer for a frame of a camera."""
        return self.tracker.process(replace(frame, camera=camera, motion=motion), self.surroundings)


def pose_of(tracked: Tracked) -> Pose | None:
    """Return the pose of an answer in its frame, None where there is none."""
    return None if tracked.placed is None else tracked.placed.frame_from_camera


def sigma_m(tracked: Tracked) -> float:
    """Return the position's standard deviation of an answer that has one."""
    assert tracked.accuracy is not None
    return tracked.accuracy.position_m
