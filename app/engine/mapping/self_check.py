"""A new map proves itself before it serves: it must locate frames of its own scan where the scan says they are."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.build_map import BuiltMap
from app.engine.mapping.examination.outcome import Examination
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.register_scan import spread
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.camera import tangent_of_px
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.importers.frames import Frame, FrameSource
from app.limits import limit

# Root mean square over median of the length of a normal vector in three dimensions.
SIGMA_PER_MEDIAN = 1.126


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfCheckOptions:
    """Which frames are located, and when the map is refused or warned of."""

    frames: int = limit(24, "Frames that are located.", chosen="By hand: a few seconds.")
    min_others: int = limit(
        8,
        "Frames beside the keyframes from which only those are located.",
        chosen="By hand: enough for a median.",
    )
    near_m: float = limit(
        0.5,
        "A frame with a keyframe this near should be located.",
        chosen="By hand: half the view is shared.",
    )
    near_rad: float = limit(0.35, "The same for the turn between them.", chosen="By hand: a third of a view.")
    min_located_share: float = limit(
        0.25,
        "Share of such frames below which the map is refused, or warned of when the scan was confirmed.",
        chosen="By hand: right scans locate more than two thirds (docs/figures/examine-mistakes.md).",
    )
    allowed_m: float = limit(
        0.05,
        "Median position error that no scan is blamed for.",
        chosen="By hand: twice the worst of docs/figures/examine-mistakes.md.",
    )
    allowed_deg: float = limit(
        1.5, "Median attitude error that no scan is blamed for.", chosen="By hand: as for the position."
    )
    accuracy_ratio: float = limit(
        2.0,
        "How much of the error that the examination allows poses is added to these.",
        chosen="By hand: keyframe and frame have it both.",
    )
    most_m: float = limit(
        0.3, "Median position error of which even a confirmed scan is refused.", chosen="By hand."
    )
    most_deg: float = limit(8.0, "The same for the attitude.", chosen="By hand.")


OPTIONS = SelfCheckOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfCheck:
    """How many of the scan's frames were tried and located, the median error of those, and what to warn of.

    `expected` counts the frames that have a keyframe nearby among those by which they were located.
    """

    tried: int
    expected: int
    located: int
    median_position_m: float | None
    median_orientation_deg: float | None
    warnings: tuple[str, ...] = ()

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
            "expected": self.expected,
            "located": self.located,
            "median_position_m": self.median_position_m,
            "median_orientation_deg": self.median_orientation_deg,
        }


def check_map(
    built: BuiltMap,
    source: FrameSource,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    examination: Examination | None = None,
) -> SelfCheck:
    """Locate frames of the scan by keyframes other than the frame itself and its neighbours in time.

    A frame would confirm any depth of its own points, and its neighbours any slow drift. Raises `InvalidScanError`
    when the map can't be right: it finds too few of the frames that have a keyframe nearby, or finds frames where
    the scan doesn't have them. Where the examination confirmed the scan, both are warnings as far as a place with
    little texture, or a long walk, explains them.
    """
    localizer = Localizer.of(built.artifact, built.index, models)
    names = {frame.name for frame in built.keyframes}
    others = [frame for frame in source.frames if frame.name not in names]
    frames = spread(others if len(others) >= OPTIONS.min_others else source.frames, OPTIONS.frames)
    allowed = {frame.name: keyframes_not_beside(frame, built.keyframes) for frame in frames}

    def error(frame: Frame) -> tuple[float, float] | None:
        found = localizer.localize(
            frame_rgb(source, frame), source.camera, allowed[frame.name]
        ).world_from_camera
        return None if found is None else _errors(found, built.world_from_scan @ frame.scan_from_camera)

    results = list(map_in_order(executor, error, frames, "verify", progress))
    errors = np.array([result for result in results if result is not None]).reshape(-1, 2)
    expected = sum(_has_neighbour(frame, built.keyframes, allowed[frame.name]) for frame in frames)
    medians = [float(value) for value in np.median(errors, axis=0)] if len(errors) else None
    return SelfCheck(
        tried=len(frames),
        expected=expected,
        located=len(errors),
        median_position_m=None if medians is None else round(medians[0], 5),
        median_orientation_deg=None if medians is None else round(medians[1], 4),
        warnings=_judged(len(errors), expected, medians, examination),
    )


def _judged(
    located: int, expected: int, medians: Sequence[float] | None, examination: Examination | None
) -> tuple[str, ...]:
    """Return what to warn of; raises `InvalidScanError` for what can't be right."""
    confirmed = examination is not None and examination.verdict == "confirmed"
    warnings = []
    if located < OPTIONS.min_located_share * expected:
        found = f"The finished map locates only {located} of {expected} frames of its own scan that it should locate"
        if not confirmed:
            raise InvalidScanError(f"{found}: check camera, depth_scale and the poses.")
        warnings.append(
            f"{found}, although pictures, depth and poses agree: few places will be found. Is there little texture? "
            "Scan closer to what is printed, and with more light."
        )
    if medians is not None:
        position_m, orientation_deg = medians
        allowed_m, allowed_deg = allowed_errors(examination)
        off = (
            f"The finished map locates its own scan's frames {position_m:.2f} m and {orientation_deg:.1f} degrees off "
            f"(median), where up to {allowed_m:.2f} m and {allowed_deg:.1f} degrees are likely"
        )
        if position_m > allowed_m or orientation_deg > allowed_deg:
            if not confirmed or position_m > OPTIONS.most_m or orientation_deg > OPTIONS.most_deg:
                raise InvalidScanError(
                    f"{off}: the poses, the depth scale or the camera don't fit the images."
                )
            warnings.append(f"{off}: the scan's positions drift, so that one place has two.")
    return tuple(warnings)


def allowed_errors(examination: Examination | None) -> tuple[float, float]:
    """Return the median errors, in metres and degrees, that the scan's accuracy makes likely."""
    figures = {} if examination is None else examination.figures
    usual_px, depth_m = figures.get("usual_error_px"), figures.get("usual_depth_m")
    angle = OPTIONS.accuracy_ratio * tangent_of_px(usual_px or 0.0)
    return OPTIONS.allowed_m + angle * (depth_m or 1.0), OPTIONS.allowed_deg + float(np.degrees(angle))


def keyframes_not_beside(frame: Frame, keyframes: Sequence[Frame]) -> NDArray[np.int64]:
    """Return the keyframes that are neither the frame nor the nearest in time before and after it."""
    times_s = np.array([keyframe.timestamp_s for keyframe in keyframes])
    same = np.array([keyframe.name == frame.name for keyframe in keyframes])
    left_out = set(np.flatnonzero(same).tolist())
    for side in (times_s <= frame.timestamp_s, times_s >= frame.timestamp_s):
        beside = np.flatnonzero(side & ~same)
        if len(beside):
            left_out.add(int(beside[np.argmin(np.abs(times_s[beside] - frame.timestamp_s))]))
    return np.array([row for row in range(len(keyframes)) if row not in left_out], dtype=np.int64)


def _has_neighbour(frame: Frame, keyframes: Sequence[Frame], rows: NDArray[np.int64]) -> bool:
    """Return whether one of some keyframes must see much of what the frame sees."""
    return any(
        position_difference_m(keyframes[row].scan_from_camera, frame.scan_from_camera) < OPTIONS.near_m
        and attitude_difference_rad(keyframes[row].scan_from_camera, frame.scan_from_camera)
        < OPTIONS.near_rad
        for row in rows.tolist()
    )


def _errors(found: Pose, truth: Pose) -> tuple[float, float]:
    return position_difference_m(found, truth), float(np.degrees(attitude_difference_rad(found, truth)))
