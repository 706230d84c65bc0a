"""A new map proves itself before it serves: it must locate frames of its own scan where the scan says they are."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.build_map import BuiltMap
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.register_scan import spread
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.importers.frames import Frame, FrameSource

SAMPLE = 24
MIN_OTHERS = 8
NEIGHBOUR_M, NEIGHBOUR_RAD = 0.5, 0.35
MIN_LOCATED_SHARE = 0.1
MAX_MEDIAN_ERROR_M = 0.3
# Root mean square over median of the length of a normal vector in three dimensions.
SIGMA_PER_MEDIAN = 1.126


@dataclass(frozen=True, slots=True)
class SelfCheck:
    """How many of the scan's frames were tried and located, and the median error of those."""

    tried: int
    located: int
    median_position_m: float | None
    median_orientation_deg: float | None

    def stated_in(self, artifact: MapArtifact) -> MapArtifact:
        """Return the map with these errors stated in it, as one sigma."""
        metadata = replace(
            artifact.metadata,
            position_sigma_m=SIGMA_PER_MEDIAN * (self.median_position_m or 0.0),
            orientation_sigma_deg=SIGMA_PER_MEDIAN * (self.median_orientation_deg or 0.0),
        )
        return replace(artifact, metadata=metadata)

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
    """Locate frames of the scan by keyframes that are not the frame itself, whose points would confirm any depth.

    Raises `InvalidScanError` when the map can't be right: it finds hardly any of the frames that have a keyframe
    nearby, or finds frames elsewhere.
    """
    localizer = Localizer.of(built.artifact, built.index, models)
    keyframes = {frame.name: row for row, frame in enumerate(built.keyframes)}
    others = [frame for frame in source.frames if frame.name not in keyframes]
    frames = spread(others if len(others) >= MIN_OTHERS else source.frames, SAMPLE)

    def error(frame: Frame) -> tuple[float, float] | None:
        allowed = _all_but(keyframes.get(frame.name), len(keyframes))
        found = localizer.localize(frame_rgb(source, frame), source.camera, allowed).world_from_camera
        return None if found is None else _errors(found, built.world_from_scan @ frame.scan_from_camera)

    results = list(map_in_order(executor, error, frames, "verify", progress))
    errors = np.array([result for result in results if result is not None]).reshape(-1, 2)
    expected = sum(_has_neighbour(frame, built.keyframes) for frame in frames)
    if len(errors) < MIN_LOCATED_SHARE * expected:
        raise InvalidScanError(
            f"The finished map locates only {len(errors)} of {len(frames)} frames of its own scan: check camera, "
            "depth_scale and the poses."
        )
    if not len(errors):
        return SelfCheck(len(frames), 0, None, None)
    position_m, orientation_deg = (float(value) for value in np.median(errors, axis=0))
    if position_m > MAX_MEDIAN_ERROR_M:
        raise InvalidScanError(
            f"The finished map locates its own scan's frames {position_m:.2f} m off (median): the poses, the depth "
            "scale or the camera don't fit the images."
        )
    return SelfCheck(len(frames), len(errors), round(position_m, 5), round(orientation_deg, 4))


def _all_but(row: int | None, count: int) -> NDArray[np.int64] | None:
    return None if row is None else np.delete(np.arange(count, dtype=np.int64), row)


def _has_neighbour(frame: Frame, keyframes: Sequence[Frame]) -> bool:
    """Return whether a keyframe other than the frame itself must see much of what the frame sees."""
    return any(
        keyframe.name != frame.name
        and position_difference_m(keyframe.scan_from_camera, frame.scan_from_camera) < NEIGHBOUR_M
        and attitude_difference_rad(keyframe.scan_from_camera, frame.scan_from_camera) < NEIGHBOUR_RAD
        for keyframe in keyframes
    )


def _errors(found: Pose, truth: Pose) -> tuple[float, float]:
    return position_difference_m(found, truth), float(np.degrees(attitude_difference_rad(found, truth)))
