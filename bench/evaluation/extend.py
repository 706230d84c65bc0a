"""What a map loses when it is made of two scans: the second one, in a frame of its own, is registered to the first."""

from __future__ import annotations

import time
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.extend_map import join_maps
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.register_scan import Registration, register_scan
from app.engine.mapping.self_check import check_map
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.errors import InvalidInputError
from app.geometry.se3 import Pose, attitude_difference_rad, rotation_from_vector
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.registry import open_scan
from bench.evaluation.dataset import parse_range
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import ErrorSummary, summarize

YAW_DEG = 137.0
MAX_TILT_DEG = 10.0
MAX_SHIFT_M = 30.0


@dataclass(frozen=True, slots=True)
class ExtendSplit:
    """Two scans of one place, and query frames that are in neither, all in the frame of the dataset."""

    first: Scan
    second: Scan
    queries: tuple[Frame, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendEvaluation:
    """The registration's figures and error (the median over the second scan's frames, and its turn), and the
    queries in the map of the first scan, in the extended map, and in the map of one scan of both parts."""

    tried: int
    located: int
    agreeing: int
    registration_cm: float
    registration_deg: float
    keyframes: dict[str, int]
    summaries: dict[str, ErrorSummary]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def split_for_extension(
    directory: Path,
    first: str,
    second: str,
    queries: str,
    format: str,  # noqa: A002
    options: ScanOptions,
) -> ExtendSplit:
    """Open a scan and split its frames by their order; raises `InvalidInputError` for an empty or shared part."""
    scan = open_scan(directory, format, options)
    rows = range(len(scan.frames))
    a, b = rows[parse_range(first)], rows[parse_range(second)]
    if set(a) & set(b):
        raise InvalidInputError("The first and the second part share frames; give parts that don't.")
    asked = [row for row in rows[parse_range(queries)] if row not in a and row not in b]
    if not a or not b or not asked:
        raise InvalidInputError(
            f"{directory.name} has {len(scan.frames)} frames: {len(a)} are left for the first part, {len(b)} for "
            f"the second and {len(asked)} for queries; all need some."
        )
    return ExtendSplit(
        replace(scan, frames=tuple(scan.frames[row] for row in a)),
        replace(scan, frames=tuple(scan.frames[row] for row in b)),
        tuple(scan.frames[row] for row in asked),
    )


def moved_scan(scan: Scan, moved_from_scan: Pose) -> Scan:
    """Return the scan with its poses in another frame, and no word on gravity."""
    frames = tuple(
        replace(frame, scan_from_camera=moved_from_scan @ frame.scan_from_camera) for frame in scan.frames
    )
    return replace(scan, frames=frames, gravity=None)


def other_frame(seed: int) -> Pose:
    """Return a motion to another frame: 137 degrees about z, a tilt of up to 10 degrees, tens of metres away."""
    rng = np.random.default_rng(seed)
    tilt = rotation_from_vector(np.radians(MAX_TILT_DEG) * np.array([*rng.uniform(-0.7, 0.7, 2), 0.0]))
    yaw = rotation_from_vector([0.0, 0.0, np.radians(YAW_DEG)])
    return Pose(tilt @ yaw, rng.uniform(0.5 * MAX_SHIFT_M, MAX_SHIFT_M, 3) * rng.choice([-1.0, 1.0], 3))


def evaluate_extension(
    split: ExtendSplit,
    options: BuildOptions,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    seed: int = 0,
) -> ExtendEvaluation:
    """Extend the first part's map by the second part, which is moved away first, and compare.

    Raises `InvalidScanError` when the second part can't be registered.
    """
    first = _checked(split.first, options, models, executor, progress)
    moved_from_scan = other_frame(seed)
    second = moved_scan(split.second, moved_from_scan)
    alone = Localizer.of(first.artifact, first.index, models)
    found = register_scan(second, alone, executor, progress)
    built = _checked(second, options, models, executor, progress, found.world_from_scan)
    binary = models.extractor(options.features).binary
    joined = join_maps(first.artifact, first.index, built.artifact, built.index, binary)
    extended = Localizer.of(*joined, models)
    both = replace(split.first, frames=split.first.frames + split.second.frames)
    one = _checked(both, options, models, executor, progress)
    single = Localizer.of(one.artifact, one.index, models)
    truth = first.world_from_scan
    registration_m, registration_deg = registration_error(found, truth @ moved_from_scan.inverse(), second)
    localizers = {"first scan": alone, "extended": extended, "one scan": single}
    summaries = {
        name: _locate(localizer, split, truth, progress, name) for name, localizer in localizers.items()
    }
    return ExtendEvaluation(
        tried=found.tried,
        located=found.located,
        agreeing=found.agreeing,
        registration_cm=round(100 * registration_m, 3),
        registration_deg=round(registration_deg, 4),
        keyframes={name: localizer.map.artifact.keyframe_count for name, localizer in localizers.items()},
        summaries=summaries,
    )


def registration_error(found: Registration, world_from_scan: Pose, scan: Scan) -> tuple[float, float]:
    """Return how far, in metres, the scan's cameras are from their true places (median), and the turn in degrees."""
    positions = np.stack([frame.scan_from_camera.translation for frame in scan.frames])
    off_m = np.linalg.norm(found.world_from_scan.apply(positions) - world_from_scan.apply(positions), axis=1)
    turn_deg = np.degrees(attitude_difference_rad(found.world_from_scan, world_from_scan))
    return float(np.median(off_m)), float(turn_deg)


def _checked(
    scan: Scan,
    options: BuildOptions,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    world_from_scan: Pose | None = None,
) -> BuiltMap:
    built = build_map(scan, options, models, executor, progress, world_from_scan)
    check = check_map(built, scan, models, executor, progress)
    return replace(built, artifact=check.stated_in(built.artifact))


def _locate(
    localizer: Localizer, split: ExtendSplit, world_from_scan: Pose, progress: Progress, stage: str
) -> ErrorSummary:
    outcomes = []
    for done, frame in enumerate(split.queries):
        progress.report(stage, done, len(split.queries))
        rgb = frame_rgb(split.first, frame)
        started = time.perf_counter()
        found = localizer.localize(rgb, split.first.camera)
        milliseconds = 1e3 * (time.perf_counter() - started)
        truth = world_from_scan @ frame.scan_from_camera
        outcomes.append(outcome_of(frame.name, found, truth, milliseconds))
    progress.report(stage, len(split.queries), len(split.queries))
    return summarize(outcomes)
