"""A new map proves itself before it serves: it must locate frames of its own scan where the scan says they are."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.errors import InvalidScanError
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.importers.frames import Frame, FrameSource
from app.services.build_map import BuiltMap
from app.services.localizer import Localizer
from app.services.progress import Progress, map_in_order
from app.services.register_scan import spread
from app.services.vision_models import VisionModels
from app.vision.images import decode_image

SAMPLE = 24
MIN_LOCATED_SHARE = 0.1
MAX_MEDIAN_ERROR_M = 0.3


@dataclass(frozen=True, slots=True)
class SelfCheck:
    """How many of the scan's frames were tried and located, and the median error of those."""

    tried: int
    located: int
    median_position_m: float | None
    median_orientation_deg: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for a report."""
        return {
            "tried": self.tried,
            "located": self.located,
            "median_position_m": self.median_position_m,
            "median_orientation_deg": self.median_orientation_deg,
        }


def check_map(
    built: BuiltMap, source: FrameSource, models: VisionModels, executor: Executor, progress: Progress
) -> SelfCheck:
    """Locate frames of the scan that are no keyframes (where there are such); raises `InvalidScanError` when the
    map can't be right: it finds hardly any of them, or finds them elsewhere."""
    localizer = Localizer(built.artifact, built.index, models)
    keyframes = {frame.name for frame in built.keyframes}
    others = [frame for frame in source.frames if frame.name not in keyframes]
    frames = spread(others or source.frames, SAMPLE)

    def error(frame: Frame) -> tuple[float, float] | None:
        found = localizer.localize(decode_image(source.color_bytes(frame)), source.camera).world_from_camera
        return None if found is None else _errors(found, built.world_from_scan @ frame.scan_from_camera)

    results = list(map_in_order(executor, error, frames, "verify", progress))
    errors = np.array([result for result in results if result is not None]).reshape(-1, 2)
    if len(errors) < max(1, MIN_LOCATED_SHARE * len(frames)):
        raise InvalidScanError(
            f"The finished map locates only {len(errors)} of {len(frames)} frames of its own scan: check camera, "
            "depth_scale and the poses."
        )
    position_m, orientation_deg = (float(value) for value in np.median(errors, axis=0))
    if position_m > MAX_MEDIAN_ERROR_M:
        raise InvalidScanError(
            f"The finished map locates its own scan's frames {position_m:.2f} m off (median): the poses, the depth "
            "scale or the camera don't fit the images."
        )
    return SelfCheck(len(frames), len(errors), round(position_m, 5), round(orientation_deg, 4))


def _errors(found: Pose, truth: Pose) -> tuple[float, float]:
    return position_difference_m(found, truth), float(np.degrees(attitude_difference_rad(found, truth)))
