"""Maps of pictures whose poses are estimated: their trajectory and their answers against the scan's own poses."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import parse_build_options
from app.engine.mapping.self_check import check_map
from app.engine.mapping.structure.estimate import EstimatedScan, estimate_poses
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.alignment import Alignment, align_points
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, position_difference_m
from app.importers.frames import Scan
from app.importers.registry import open_unposed
from app.importers.unpack_scan import unpack_scan
from bench.evaluation.pose_errors import ErrorSummary
from bench.formats.evaluate import FormatQueries, locate_queries

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnposedResult:
    """What a map of pictures without poses does.

    `trajectory_cm` is the median error of the estimated positions after the alignment, `scale_error` what that finds
    the map too large by (0.01 is one percent), None where the map has no scale. `up_error_deg` is None where up was not
    found or is not known. `summary` are the queries' errors after the same alignment.
    """

    name: str
    report: Mapping[str, Any]
    camera: Camera
    trajectory_cm: float
    scale_error: float | None
    up_error_deg: float | None
    keyframes: int
    build_s: float
    build_processor_s: float
    summary: ErrorSummary


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """What is sent: a folder or file, its options, and which frame of the scan each picture is, by its name.

    With `is_rigid` the alignment leaves the map's scale as it is.
    """

    name: str
    path: Path
    options: Mapping[str, Any]
    is_rigid: bool = False


def evaluate_unposed(
    sent: Sent,
    truth: Scan,
    down: Array | None,
    queries: FormatQueries,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    scratch: Path,
) -> UnposedResult:
    """Build a map of what is sent and locate the queries; `truth` has the frames that were written, in their order, and
    `down` (3,) is in the frame of its poses."""
    started, processor_started = time.perf_counter(), time.process_time()
    options = parse_build_options(sent.options)
    root = sent.path if sent.path.is_dir() else unpack_scan(sent.path, scratch / "unpacked")
    unposed = open_unposed(root, options.format, replace(options.scan, scratch=scratch))
    if unposed is None:
        raise InvalidScanError(f"{sent.name} has poses.")
    estimate = estimate_poses(unposed, options.scale, models, executor, progress)
    built = build_map(estimate.scan, options, models, executor, progress)
    check = check_map(built, estimate.scan, models, executor, progress)
    build_s = time.perf_counter() - started
    build_processor_s = time.process_time() - processor_started
    localizer = Localizer.of(check.stated_in(built.artifact), built.index, models)
    positions = np.array([frame.scan_from_camera.translation for frame in estimate.scan.frames])
    true = [true_pose_of(frame.name, frame.timestamp_s, truth) for frame in estimate.scan.frames]
    true_from_world = align_points(
        built.world_from_scan.apply(positions), [p.translation for p in true], with_scale=not sent.is_rigid
    )
    aligned = [
        _aligned(built.world_from_scan @ frame.scan_from_camera, true_from_world)
        for frame in estimate.scan.frames
    ]
    errors = [position_difference_m(pose, own) for pose, own in zip(aligned, true, strict=True)]
    return UnposedResult(
        name=sent.name,
        report=estimate.report,
        camera=estimate.scan.camera,
        trajectory_cm=100 * float(np.median(errors)),
        scale_error=_scale_error(positions, true) if estimate.scan.has_scale else None,
        up_error_deg=_up_error_deg(estimate, true, down),
        keyframes=built.artifact.keyframe_count,
        build_s=build_s,
        build_processor_s=build_processor_s,
        summary=locate_queries(localizer, queries, lambda pose: _aligned(pose, true_from_world), progress),
    )


def true_pose_of(name: str, time_s: float, truth: Scan) -> Pose:
    """Return the pose of the frame of the scan that a picture was written from: by its number, else by its time."""
    stem = Path(name).stem
    if stem.isdigit():
        return truth.frames[int(stem)].scan_from_camera
    nearest = int(np.argmin([abs(frame.timestamp_s - time_s) for frame in truth.frames]))
    return truth.frames[nearest].scan_from_camera


def _scale_error(positions: Array, true: list[Pose]) -> float:
    """Return by what the estimated positions (n, 3), in metres, are too large (0.01: one percent)."""
    return 1.0 / align_points(positions, [pose.translation for pose in true], with_scale=True).scale - 1.0


def _up_error_deg(estimate: EstimatedScan, true: list[Pose], down: Array | None) -> float | None:
    if estimate.scan.gravity is None or down is None:
        return None
    found = [
        pose.rotation @ frame.scan_from_camera.rotation.T @ np.array(estimate.scan.gravity)
        for frame, pose in zip(estimate.scan.frames, true, strict=True)
    ]
    mean = np.mean(found, axis=0)
    return float(
        np.degrees(np.arccos(np.clip(mean @ down / np.linalg.norm(mean) / np.linalg.norm(down), -1, 1)))
    )


def _aligned(world_from_camera: Pose, true_from_world: Alignment) -> Pose:
    turn = true_from_world.target_from_source
    return turn @ Pose(world_from_camera.rotation, true_from_world.scale * world_from_camera.translation)
