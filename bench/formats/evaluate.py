"""A map of the same frames from every format, and the same queries located in it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from app.engine.mapping.build_map import build_map
from app.engine.mapping.self_check import check_map
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan
from app.importers.registry import open_scan
from app.importers.unpack_scan import unpack_scan
from app.services.examine_scan import examined_scan
from app.vision.images import decode_image
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import ErrorSummary, summarize
from bench.formats.frames import Writer, WrittenScan


@dataclass(frozen=True, slots=True, kw_only=True)
class FormatResult:
    """What a format's map does: megabytes that were sent, frames that were read, the examination's verdict, the
    keyframes, seconds from file to map, and the queries' errors."""

    name: str
    megabytes: float
    frames: int
    verdict: str
    keyframes: int
    build_s: float
    summary: ErrorSummary


@dataclass(frozen=True, slots=True)
class FormatQueries:
    """The scan that the frames are from, and those of its frames that are located."""

    scan: Scan
    frames: tuple[Frame, ...]


def evaluate_formats(
    written: WrittenScan,
    queries: FormatQueries,
    writers: dict[str, Writer],
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> Iterator[FormatResult]:
    """Yield the result of each format; each is written into a folder that is deleted afterwards."""
    for name, write in writers.items():
        with tempfile.TemporaryDirectory(prefix="roomfix-formats-") as folder:
            sent = write(written, Path(folder) / "scan")
            yield _evaluate(name, sent, Path(folder), written, queries, models, executor, progress)


def _evaluate(
    name: str,
    sent: Path,
    folder: Path,
    written: WrittenScan,
    queries: FormatQueries,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> FormatResult:
    started = time.perf_counter()
    root = sent if sent.is_dir() else unpack_scan(sent, folder / "unpacked")
    examined = examined_scan(root, open_scan(root), {}, executor, progress)
    scan = examined.scan
    built = build_map(scan, examined.options, models, executor, progress)
    check = check_map(built, scan, models, executor, progress, examined.examination)
    build_s = time.perf_counter() - started
    localizer = Localizer.of(check.stated_in(built.artifact), built.index, models)
    # A format's own world is the scan's turned by one rotation.
    format_from_scan = scan.frames[0].scan_from_camera @ written.frames[0].scan_from_camera.inverse()
    world_from_scan = built.world_from_scan @ format_from_scan
    return FormatResult(
        name=name,
        megabytes=_megabytes(sent),
        frames=len(scan.frames),
        verdict=examined.examination.verdict if examined.examination else "none",
        keyframes=built.artifact.keyframe_count,
        build_s=build_s,
        summary=locate_queries(localizer, queries, world_from_scan.inverse().__matmul__, progress),
    )


def locate_queries(
    localizer: Localizer, queries: FormatQueries, in_truth: Callable[[Pose], Pose], progress: Progress
) -> ErrorSummary:
    """Locate the queries; `in_truth` maps a pose in the map to the frame of their true poses."""
    outcomes = []
    for done, frame in enumerate(queries.frames):
        progress.report("locate", done, len(queries.frames))
        rgb = decode_image(queries.scan.color_bytes(frame))
        started = time.perf_counter()
        found = localizer.localize(rgb, queries.scan.camera)
        milliseconds = 1e3 * (time.perf_counter() - started)
        pose, candidate = found.world_from_camera, found.candidate
        aligned = replace(
            found,
            world_from_camera=None if pose is None else in_truth(pose),
            candidate=None if candidate is None else in_truth(candidate),
        )
        outcomes.append(outcome_of(frame.name, aligned, frame.scan_from_camera, milliseconds))
    return summarize(outcomes)


def _megabytes(sent: Path) -> float:
    files: Sequence[Path] = [sent] if sent.is_file() else [p for p in sent.rglob("*") if p.is_file()]
    return sum(path.stat().st_size for path in files) / 1e6
