"""Where a scan lies in the world, found by locating its frames in the venue's present map."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from app.engine.mapping.frame_images import frame_rgb
from app.engine.progress import Progress, map_in_order
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.alignment import average_poses
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.importers.frames import Frame, FrameSource

SAMPLE = 40
MIN_AGREEING = 5
MIN_AGREEING_SHARE = 0.5
AGREE_M = 0.15
AGREE_RAD = float(np.radians(2.5))
# Nearer than this to a keyframe a placement gets no better.
NEAR_KEYFRAME_M = 0.05


@dataclass(frozen=True, slots=True)
class Registration:
    """`world_from_scan`, from `agreeing` of the `located` frames among `tried`."""

    world_from_scan: Pose
    tried: int
    located: int
    agreeing: int


def register_scan(
    source: FrameSource, localizer: Localizer, executor: Executor, progress: Progress
) -> Registration:
    """Locate up to 40 frames of the scan, and average the placements that agree, those near a keyframe most.

    Raises `InvalidScanError` with the figures when too few are located or agree.
    """
    frames = spread(source.frames, SAMPLE)
    # Placements are compared and averaged amid the frames: at an origin far from them a small turn is a long way.
    scan_from_middle = middle_of(source.frames)

    def place(frame: Frame) -> _Placement | None:
        found = localizer.localize(frame_rgb(source, frame), source.camera)
        if found.world_from_camera is None:
            return None
        world_from_middle = found.world_from_camera @ frame.scan_from_camera.inverse() @ scan_from_middle
        return _Placement(world_from_middle, found.evidence.keyframe_distance_m)

    results = list(map_in_order(executor, place, frames, "register", progress))
    placements = [placement for placement in results if placement is not None]
    agreeing = largest_agreement([placement.world_from_middle for placement in placements])
    if len(agreeing) < max(MIN_AGREEING, MIN_AGREEING_SHARE * len(placements)):
        raise InvalidScanError(
            f"The scan can't be placed in the present map: of {len(frames)} frames {len(placements)} were located "
            f"and {len(agreeing)} agree; give world_from_scan, or scan more of what the map holds."
        )
    chosen = {id(pose) for pose in agreeing}
    weights = [one.weight for one in placements if id(one.world_from_middle) in chosen]
    world_from_scan = average_poses(agreeing, weights) @ scan_from_middle.inverse()
    return Registration(world_from_scan, len(frames), len(placements), len(agreeing))


@dataclass(frozen=True, slots=True)
class _Placement:
    world_from_middle: Pose
    keyframe_distance_m: float

    @property
    def weight(self) -> float:
        # Seen from beside a keyframe, what is wrong with its points' depth hardly moves the camera.
        return 1.0 / (self.keyframe_distance_m + NEAR_KEYFRAME_M) ** 2


def middle_of(frames: Sequence[Frame]) -> Pose:
    """Return the `scan_from_middle` of a frame with the scan's axes whose origin is amid the cameras."""
    positions = np.stack([frame.scan_from_camera.translation for frame in frames])
    return Pose(np.eye(3), np.median(positions, axis=0))


def largest_agreement(placements: Sequence[Pose]) -> list[Pose]:
    """Return the largest group of placements that are close to one of them."""
    groups = [[other for other in placements if _agree(one, other)] for one in placements]
    return max(groups, key=len, default=[])


def _agree(a: Pose, b: Pose) -> bool:
    return position_difference_m(a, b) < AGREE_M and attitude_difference_rad(a, b) < AGREE_RAD


def spread(frames: Sequence[Frame], count: int) -> list[Frame]:
    """Return at most `count` frames, evenly spread."""
    if len(frames) <= count:
        return list(frames)
    return [frames[i] for i in np.linspace(0, len(frames) - 1, count).round().astype(int)]
