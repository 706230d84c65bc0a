"""Evaluation of tracking: the frames of a dataset as a video, with the map or mostly without it (C 5.1, 7)."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import BuildOptions
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.camera import scanned_camera
from app.engine.query.localizer import Localizer
from app.engine.tracking.fix import Fix, FixSource, MapFixes, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracker import Tracker
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.frames import Frame
from app.vision.images import decode_image
from bench.evaluation.dataset import Split
from bench.evaluation.pose_errors import pose_error


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """When the map may be used: always, or, with `map_frames`, on that number of first frames and then on every
    `relocalize_every`-th, if that is given. Every `locate_every`-th frame is located by itself too, for its time.

    With `and_back` the phone goes by every second frame and comes back by those between, in turn as often as this says.
    Without `own_views` the tracker does not recognise what it has seen itself.
    """

    map_frames: int | None = None
    relocalize_every: int | None = None
    locate_every: int = 4
    and_back: int = 0
    own_views: bool = True

    def is_open(self, frame: int) -> bool:
        """Whether the map may be used on a frame."""
        if self.map_frames is None or frame < self.map_frames:
            return True
        return self.relocalize_every is not None and frame % self.relocalize_every == 0


@dataclass(slots=True)
class _Gate:
    """A source that gives fixes only while it is open."""

    source: FixSource
    is_open: bool = True

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False
    ) -> Fix | NoFix:
        """Return the source's fix, none while closed."""
        return self.source.locate(frame, camera, near, any_floor) if self.is_open else NoFix("no_map")

    def refresh(self, frame: TrackingFrame, camera: Camera, predicted: Pose) -> Fix | None:
        """Return the source's fix, none while closed."""
        return self.source.refresh(frame, camera, predicted) if self.is_open else None

    def nearby(self, frame: TrackingFrame, camera: Camera, near: Pose, reach_m: float) -> Fix | None:
        """Return the source's fix, none while closed."""
        return self.source.nearby(frame, camera, near, reach_m) if self.is_open else None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackedFrame:
    """One frame: state, errors (infinite when it was not located), sigma, time, and both positions."""

    name: str
    state: str
    reason: str | None
    error_m: float
    error_deg: float
    sigma_m: float | None
    milliseconds: float
    truth: list[float]
    position: list[float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingFigures:
    """The figures of one video.

    Shares are of all frames; errors of those tracked. `drift_percent` is the error at the last tracked frame over
    the path that far, `largest_error_percent` the largest error over the whole path. `scale` is the distance that
    was tracked between the two tracked places that are furthest apart, over the true one, `scale_distance_m`.
    """

    frames: int
    tracked_percent: float
    median_cm: float | None
    p90_cm: float | None
    mean_cm: float | None
    max_cm: float | None
    median_deg: float | None
    within_3_sigma_percent: float | None
    wrong_by_half_a_metre: int
    path_m: float
    drift_percent: float | None
    largest_error_percent: float | None
    scale: float | None
    scale_distance_m: float | None
    mean_ms: float
    median_ms: float
    locate_mean_ms: float
    locate_median_ms: float
    time_share: float
    states: dict[str, int]
    reasons: dict[str, int]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def track_video(
    split: Split,
    options: BuildOptions,
    settings: VideoSettings,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> tuple[TrackingFigures, list[TrackedFrame]]:
    """Build the map of the database's frames and track the queries as a video, each at its own time."""
    built = build_map(split.database, options, models, executor, progress)
    localizer = Localizer.of(built.artifact, built.index, models)
    gate = _Gate(MapFixes(localizer))
    # A closed gate costs nothing, and an open one is to be used.
    limited = TrackerSettings(relocalize_every=1, use_refresh=False, use_own_views=settings.own_views)
    tracker = Tracker(
        settings=TrackerSettings(use_own_views=settings.own_views) if settings.map_frames is None else limited
    )
    camera, frames, locate_ms = scanned_camera(localizer.map.artifact.metadata, split.database.camera), [], []
    video = there_and_back(split.queries, settings.and_back)
    for i, (frame, time_s) in enumerate(video):
        progress.report("track", i, len(video))
        data = split.database.color_bytes(frame)
        gate.is_open = settings.is_open(i)
        started = time.perf_counter()
        rgb = decode_image(data)
        decoded = time.perf_counter()
        tracked = tracker.process(TrackingFrame.of(rgb, time_s, camera=camera), Surroundings(gate))
        milliseconds = 1e3 * (time.perf_counter() - started)
        truth = built.world_from_scan @ frame.scan_from_camera
        pose = None if tracked.placed is None else tracked.placed.frame_from_camera
        error_m, error_deg = (float("inf"), 180.0) if pose is None else pose_error(pose, truth)
        frames.append(
            TrackedFrame(
                name=frame.name,
                state=tracked.state,
                reason=tracked.reason,
                error_m=error_m,
                error_deg=error_deg,
                sigma_m=None if tracked.accuracy is None else tracked.accuracy.position_m,
                milliseconds=milliseconds,
                truth=truth.translation.tolist(),
                position=None if pose is None else pose.translation.tolist(),
            )
        )
        if i % settings.locate_every == 0:
            begun = time.perf_counter()
            localizer.localize(rgb, camera)
            locate_ms.append(1e3 * (time.perf_counter() - begun + decoded - started))
    progress.report("track", len(video), len(video))
    return summarize_tracking(frames, locate_ms), frames


def there_and_back(frames: Sequence[Frame], times: int) -> list[tuple[Frame, float]]:
    """Return the frames of a video with their times, seconds; with `times` those of a phone that goes there by every
    second frame and back by the others, so often: no picture but the turning points' comes twice in one loop."""
    if not times:
        return [(frame, frame.timestamp_s) for frame in frames]
    loop = [*frames[::2], *reversed(frames[1::2])]
    way = [*loop, *(frame for _ in range(times - 1) for frame in loop)]
    start_s = way[0].timestamp_s
    taken_s = np.cumsum([0.0, *(abs(b.timestamp_s - a.timestamp_s) for a, b in pairwise(way))])
    return [(frame, start_s + float(at_s)) for frame, at_s in zip(way, taken_s, strict=True)]


def summarize_tracking(frames: Sequence[TrackedFrame], locate_ms: Sequence[float]) -> TrackingFigures:
    """Return the figures of a video's frames, and of the times of located ones."""
    truth = np.array([frame.truth for frame in frames])
    path_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth, axis=0), axis=1))])
    rows = [i for i, frame in enumerate(frames) if frame.position is not None]
    metres = np.array([frames[i].error_m for i in rows])
    degrees = np.array([frames[i].error_deg for i in rows])
    sigmas = np.array([frames[i].sigma_m for i in rows], dtype=float)
    times = np.array([frame.milliseconds for frame in frames])
    scale, distance_m = tracked_scale(truth[rows], np.array([frames[i].position for i in rows]))
    last = rows[-1] if rows else 0
    return TrackingFigures(
        frames=len(frames),
        tracked_percent=round(100.0 * len(rows) / len(frames), 2),
        median_cm=_rounded(100 * metres, np.median, 2),
        p90_cm=_rounded(100 * metres, lambda values: np.percentile(values, 90), 2),
        mean_cm=_rounded(100 * metres, np.mean, 2),
        max_cm=_rounded(100 * metres, np.max, 2),
        median_deg=_rounded(degrees, np.median, 3),
        within_3_sigma_percent=_rounded(100.0 * (metres <= 3 * sigmas), np.mean, 1),
        wrong_by_half_a_metre=int(np.count_nonzero(metres > 0.5)),
        path_m=round(float(path_m[-1]), 3),
        drift_percent=round(100 * frames[last].error_m / path_m[last], 2)
        if rows and path_m[last] > 0
        else None,
        largest_error_percent=_rounded(100 * metres / max(path_m[-1], 1e-9), np.max, 2),
        scale=scale,
        scale_distance_m=distance_m,
        mean_ms=round(float(times.mean()), 1),
        median_ms=round(float(np.median(times)), 1),
        locate_mean_ms=round(float(np.mean(locate_ms)), 1),
        locate_median_ms=round(float(np.median(locate_ms)), 1),
        time_share=round(float(times.mean() / np.mean(locate_ms)), 3),
        states=dict(Counter(frame.state for frame in frames)),
        reasons=dict(Counter(frame.reason for frame in frames if frame.reason is not None)),
    )


def tracked_scale(
    truth: np.ndarray[Any, Any], tracked: np.ndarray[Any, Any]
) -> tuple[float | None, float | None]:
    """Return the tracked distance between the two true places (n, 3) furthest apart over the true one, and that one in
    metres."""
    if len(truth) < 2:
        return None, None
    apart = np.linalg.norm(truth[:, None] - truth[None], axis=2)
    a, b = np.unravel_index(int(apart.argmax()), apart.shape)
    distance_m = float(apart[a, b])
    return round(float(np.linalg.norm(tracked[a] - tracked[b])) / max(distance_m, 1e-9), 4), round(
        distance_m, 3
    )


def _rounded(values: np.ndarray[Any, Any], of: Any, digits: int) -> float | None:
    return round(float(of(values)), digits) if len(values) else None
