"""Evaluation: build a map from one part of a dataset, locate the other part, compare with the truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.evaluation.dataset import Split
from app.evaluation.pipelines import FrameLocalizer, Pipeline, open_pipeline
from app.evaluation.pose_errors import ErrorSummary, QueryOutcome, pose_error, summarize
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.frames import Frame
from app.services.build_map import BuiltMap, build_map
from app.services.build_options import BuildOptions
from app.services.localizer import Localization, LocalizerSettings
from app.services.progress import Progress
from app.services.vision_models import VisionModels
from app.vision.images import Rgb, decode_image

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The figures of one configuration on one dataset."""

    name: str
    features: str
    keyframes: int
    features_per_keyframe: float
    megabytes: float
    build_s: float
    discarded: dict[str, int]
    summary: ErrorSummary
    stages_ms: dict[str, float]
    outcomes: tuple[QueryOutcome, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return {
            "name": self.name,
            "features": self.features,
            "keyframes": self.keyframes,
            "features_per_keyframe": self.features_per_keyframe,
            "megabytes": self.megabytes,
            "build_s": self.build_s,
            "discarded": self.discarded,
            "summary": self.summary.as_dict(),
            "stages_ms": self.stages_ms,
            "outcomes": [
                {name: getattr(outcome, name) for name in QueryOutcome.__slots__} for outcome in self.outcomes
            ],
        }


def evaluate(
    name: str,
    split: Split,
    options: BuildOptions,
    settings: LocalizerSettings,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    pipeline: Pipeline = "default",
) -> tuple[Evaluation, FrameLocalizer]:
    """Build, locate every query and compare; return the figures and the localizer."""
    started = time.perf_counter()
    built = build_map(split.database, options, models, executor, progress)
    build_s = time.perf_counter() - started
    localizer = open_pipeline(pipeline, built, models, settings)
    results = []
    for done, frame in enumerate(split.queries):
        progress.report("locate", done, len(split.queries))
        results.append(_query(localizer, split, frame, built.world_from_scan))
    progress.report("locate", len(split.queries), len(split.queries))
    outcomes = tuple(outcome for outcome, _ in results)
    stages = median_stages([found for _, found in results if found.world_from_camera is not None])
    figures = Evaluation(
        name=name,
        features=options.features,
        keyframes=built.artifact.keyframe_count,
        features_per_keyframe=round(built.artifact.feature_count / built.artifact.keyframe_count, 1),
        megabytes=round(_bytes(built) / 1e6, 2),
        build_s=round(build_s, 2),
        discarded={reason: len(names) for reason, names in built.discarded.items()},
        summary=summarize(outcomes),
        stages_ms=stages,
        outcomes=outcomes,
    )
    return figures, localizer


def _query(
    localizer: FrameLocalizer, split: Split, frame: Frame, world_from_scan: Pose
) -> tuple[QueryOutcome, Localization]:
    rgb = decode_image(split.database.color_bytes(frame))
    started = time.perf_counter()
    found = localizer.localize(rgb, split.database.camera)
    milliseconds = 1e3 * (time.perf_counter() - started)
    pose, position_m, orientation_deg = found.world_from_camera, float("inf"), 180.0
    if pose is not None:
        position_m, orientation_deg = pose_error(pose, world_from_scan @ frame.scan_from_camera)
    outcome = QueryOutcome(
        frame.name,
        pose is not None,
        position_m,
        orientation_deg,
        found.reason,
        found.evidence.inliers,
        found.confidence,
        milliseconds,
    )
    return outcome, found


def count_false_fixes(
    localizer: FrameLocalizer, images: Sequence[Path], camera: Camera
) -> tuple[list[Path], int]:
    """Locate images of places that are not in the map; return those that were located all the same, and the
    highest inlier count."""
    false, highest = [], 0
    for path in images:
        rgb = decode_image(path.read_bytes())
        found = localizer.localize(rgb, _fitted(camera, rgb))
        highest = max(highest, found.evidence.inliers)
        if found.world_from_camera is not None:
            false.append(path)
    return false, highest


def list_images(directory: Path) -> list[Path]:
    """Return the image files of a folder, by name."""
    return sorted(path for path in directory.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def median_stages(results: Sequence[Localization]) -> dict[str, float]:
    """Return the median milliseconds of each stage over several results."""
    names = list(dict.fromkeys(name for found in results for name in found.timings_ms))
    return {name: round(_median([found.timings_ms.get(name, 0.0) for found in results]), 2) for name in names}


def _fitted(camera: Camera, rgb: Rgb) -> Camera:
    """Return the same field of view for an image of another size."""
    height, width = rgb.shape[:2]
    focal_px = camera.focal_px * max(width, height) / max(camera.width, camera.height)
    return Camera("PINHOLE", width, height, (focal_px, focal_px, (width - 1) / 2, (height - 1) / 2))


def _bytes(built: BuiltMap) -> int:
    arrays = built.artifact.arrays
    packed = sum(int(getattr(arrays, name).nbytes) for name in type(arrays).__slots__)
    return packed + int(built.index.descriptors.nbytes)


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])
