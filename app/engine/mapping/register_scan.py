"""Registration: where a scan lies in the world, by locating its frames in the venue's present map."""

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
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class RegistrationOptions:
    """How many frames are located, and when their placements agree."""

    frames: int = limit(
        40, "Largest number of frames that are located.", chosen="By hand; no measurement is recorded."
    )
    min_agreeing: int = limit(
        5, "Least number of placements that agree.", chosen="By hand; no measurement is recorded."
    )
    min_agreeing_share: float = limit(
        0.5,
        "Least fraction of the placements that agree.",
        chosen="By hand: with the majority, no second group can be as large.",
    )
    max_position_difference_m: float = limit(
        0.15,
        "Largest position difference of two placements that agree.",
        chosen="By hand; no measurement is recorded.",
    )
    max_attitude_difference_deg: float = limit(
        2.5,
        "Largest attitude difference of two placements that agree.",
        chosen="By hand; no measurement is recorded.",
    )
    weight_offset_m: float = limit(
        0.05,
        "Length added to the distance from the nearest keyframe, whose inverse square weights a placement.",
        chosen="By hand: nearer to a keyframe than this a placement gets no more accurate.",
    )


OPTIONS = RegistrationOptions()
MAX_ATTITUDE_DIFFERENCE_RAD = float(np.radians(OPTIONS.max_attitude_difference_deg))


class UnregisteredScanError(InvalidScanError):
    """Too few frames of a scan were located in the present map, or too few of those agree."""

    def __init__(self, tried: int, located: int, agreeing: int) -> None:
        super().__init__(
            f"The scan can't be placed in the present map: of {tried} frames {located} were located "
            f"and {agreeing} agree; give world_from_scan, or scan more of what the map holds."
        )
        self.tried, self.located, self.agreeing = tried, located, agreeing


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
    """Return where a scan lies in the world: the mean of its located frames' placements that agree.

    A sample of its frames is located in the present map; frames near a keyframe have more weight. Raises
    `UnregisteredScanError` with the figures when too few are located or agree.
    """
    frames = spread(source.frames, OPTIONS.frames)
    # Placements are compared and averaged in a frame in the middle of the scan: with an origin far from the cameras
    # a small error of the rotation would be a large one of the position.
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
    if len(agreeing) < max(OPTIONS.min_agreeing, OPTIONS.min_agreeing_share * len(placements)):
        raise UnregisteredScanError(len(frames), len(placements), len(agreeing))
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
        # Near a keyframe's own position an error of its points' depth hardly changes the pose.
        return 1.0 / (self.keyframe_distance_m + OPTIONS.weight_offset_m) ** 2


def middle_of(frames: Sequence[Frame]) -> Pose:
    """Return `scan_from_middle`, of a frame with the scan's axes and its origin at the median of the cameras."""
    positions = np.stack([frame.scan_from_camera.translation for frame in frames])
    return Pose(np.eye(3), np.median(positions, axis=0))


def largest_agreement(placements: Sequence[Pose]) -> list[Pose]:
    """Return the largest group of placements that agree with one of them."""
    groups = [[other for other in placements if _agree(one, other)] for one in placements]
    return max(groups, key=len, default=[])


def _agree(a: Pose, b: Pose) -> bool:
    return (
        position_difference_m(a, b) < OPTIONS.max_position_difference_m
        and attitude_difference_rad(a, b) < MAX_ATTITUDE_DIFFERENCE_RAD
    )


def spread(frames: Sequence[Frame], count: int) -> list[Frame]:
    """Return at most `count` frames, evenly spread."""
    if len(frames) <= count:
        return list(frames)
    return [frames[i] for i in np.linspace(0, len(frames) - 1, count).round().astype(int)]
