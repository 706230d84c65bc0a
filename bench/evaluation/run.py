"""Evaluation: build a map from one part of a dataset, locate the other part, compare with the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.options import BuildOptions
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localization import Localization
from app.engine.query.settings import LocalizerSettings
from app.geometry.se3 import Pose
from app.importers.frames import Frame
from app.vision.images import decode_image
from app.vision.keyframes import PoseThresholds
from bench.evaluation.absent import AbsentResult
from bench.evaluation.dataset import Split
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pipelines import FrameLocalizer, Pipeline, open_pipeline
from bench.evaluation.pose_errors import ErrorSummary, QueryOutcome, summarize
from bench.evaluation.variations import PLAIN, Variation


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFigures:
    """What is known of the map behind an evaluation; `configuration` distinguishes the maps of one report.

    `frames` are those that the map was made of, `thresholds` those of the pose rule (None for another rule),
    `lens_k1` is the radial coefficient that the scan showed where it states none, `keyframe_centres` (x, y, z) in the
    world. Values that aren't known for a map of unknown origin are None.
    """

    configuration: str
    features: str
    keyframes: int
    features_per_keyframe: float
    megabytes: float
    frames: int | None = None
    build_s: float | None = None
    discarded: Mapping[str, int] | None = None
    thresholds: PoseThresholds | None = None
    lens_k1: float | None = None
    keyframe_centres: tuple[tuple[float, float, float], ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        thresholds = self.thresholds
        return {
            "name": self.configuration,
            "features": self.features,
            "frames": self.frames,
            "keyframes": self.keyframes,
            "features_per_keyframe": self.features_per_keyframe,
            "megabytes": self.megabytes,
            "lens_k1": self.lens_k1,
            "build_s": self.build_s,
            "discarded": None if self.discarded is None else dict(self.discarded),
            "keyframe_thresholds": None
            if thresholds is None
            else {
                "position_m": round(thresholds.position_m, 4),
                "attitude_rad": round(thresholds.attitude_rad, 4),
            },
            "keyframe_centres": self.keyframe_centres,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The figures of one variation of the queries on one map."""

    map: MapFigures
    variation: str
    summary: ErrorSummary
    stages_ms: Mapping[str, float]
    outcomes: tuple[QueryOutcome, ...]
    absent: AbsentResult | None = None

    @property
    def label(self) -> str:
        """The configuration, and the variation unless it is the plain one."""
        plain = self.variation == PLAIN.name
        return self.configuration if plain else f"{self.configuration}, {self.variation}"

    @property
    def configuration(self) -> str:
        """The map's name and feature method."""
        return f"{self.map.configuration}, {self.map.features}"

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        out = {
            **self.map.as_dict(),
            "variation": self.variation,
            "summary": self.summary.as_dict(),
            "stages_ms": dict(self.stages_ms),
            "outcomes": [outcome.as_dict() for outcome in self.outcomes],
        }
        return out if self.absent is None else {**out, "absent": self.absent.as_dict()}


@dataclass(frozen=True, slots=True)
class EvaluatedMap:
    """A map that was built for evaluation, and what localizes in it."""

    figures: MapFigures
    localizer: FrameLocalizer
    world_from_scan: Pose


def build(
    configuration: str,
    split: Split,
    options: BuildOptions,
    settings: LocalizerSettings,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    pipeline: Pipeline = "default",
) -> EvaluatedMap:
    """Build the map of a split's database; it serves any number of variations."""
    started = time.perf_counter()
    built = build_map(split.database, options, models, executor, progress)
    figures = replace(
        map_figures(configuration, built.artifact, int(built.index.descriptors.nbytes)),
        frames=len(split.database.frames),
        build_s=round(time.perf_counter() - started, 2),
        discarded={reason: len(names) for reason, names in built.discarded.items()},
        thresholds=_thresholds(built, options),
    )
    localizer = open_pipeline(pipeline, built, models, settings)
    return EvaluatedMap(figures, localizer, built.world_from_scan)


def evaluate(
    built: EvaluatedMap, split: Split, progress: Progress, variation: Variation = PLAIN
) -> Evaluation:
    """Locate every query of a split, as the variation has it, and compare with the truth."""
    stage = f"locate {variation.name}" if variation != PLAIN else "locate"
    outcomes, timings = [], []
    for done, frame in enumerate(split.queries):
        progress.report(stage, done, len(split.queries))
        outcome, found = _query(built, split, frame, done, variation)
        outcomes.append(outcome)
        if found.world_from_camera is not None:
            timings.append(found.timings_ms)
    progress.report(stage, len(split.queries), len(split.queries))
    return Evaluation(
        map=built.figures,
        variation=variation.name,
        summary=summarize(outcomes),
        stages_ms=median_stages(timings),
        outcomes=tuple(outcomes),
    )


def map_figures(configuration: str, artifact: MapArtifact, index_bytes: int) -> MapFigures:
    """Return the figures that a map's artefact holds; `index_bytes` is the size of its global descriptors."""
    arrays = artifact.arrays
    packed = sum(int(getattr(arrays, name).nbytes) for name in type(arrays).__slots__)
    packed += 0 if artifact.second is None else artifact.second.nbytes
    return MapFigures(
        configuration=configuration,
        features=artifact.metadata.features,
        keyframes=artifact.keyframe_count,
        features_per_keyframe=round(artifact.feature_count / artifact.keyframe_count, 1),
        megabytes=round((packed + index_bytes) / 1e6, 2),
        lens_k1=next((round(lens.coefficient, 4) for _, lens in artifact.metadata.shown_lenses), None),
        keyframe_centres=tuple(
            (round(x, 4), round(y, 4), round(z, 4)) for x, y, z in arrays.positions.tolist()
        ),
    )


def _query(
    built: EvaluatedMap, split: Split, frame: Frame, number: int, variation: Variation
) -> tuple[QueryOutcome, Localization]:
    rgb = decode_image(split.database.color_bytes(frame))
    asked = variation.apply(number, frame.name, rgb, split.database.camera)
    started = time.perf_counter()
    found = built.localizer.localize(asked.rgb, asked.camera if variation.camera_given else None)
    milliseconds = 1e3 * (time.perf_counter() - started)
    truth = built.world_from_scan @ frame.scan_from_camera @ asked.original_from_degraded
    return outcome_of(frame.name, found, truth, milliseconds), found


def median_stages(timings_ms: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the median milliseconds of each stage over several queries."""
    names = list(dict.fromkeys(name for timings in timings_ms for name in timings))
    return {name: round(_median([timings.get(name, 0.0) for timings in timings_ms]), 2) for name in names}


def _thresholds(built: BuiltMap, options: BuildOptions) -> PoseThresholds | None:
    if options.keyframes.rule != "pose":
        return None
    return options.keyframes.thresholds if built.calibration is None else built.calibration.thresholds


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])
