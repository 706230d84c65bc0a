"""Keyframe rules compared: how many, how alike, how large, how accurate (B section 3, tables 3-7)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.options import BuildOptions
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.geometry.se3 import Pose
from app.importers.frames import FrameSource
from app.vision.content_keyframes import ContentRule, ContentSelector, FrameContent
from app.vision.features import LocalFeatureExtractor
from app.vision.matching import to_unit_vectors
from app.vision.similarity import content_similarity
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pipelines import FrameLocalizer, Pipeline, open_pipeline
from bench.evaluation.pose_errors import ErrorSummary, QueryOutcome, summarize
from bench.evaluation.queries import Query

# The paper's tables end at 0.40.
ALPHAS = (0.45, 0.40, 0.35, 0.30, 0.25)
BETA_STEPS = (0.05, 0.10, 0.15, 0.20)
# Least ratio of the similarity of neighbouring keyframes to that of the scan's own neighbours: below it the map is
# less accurate than one of all frames (docs/figures/keyframes.md).
WANTED_SHARE = 0.62


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleFigures:
    """One rule on one scan. `map_mb` is features and index, `pictures_mb` what the keyframes' images take more;
    similarities are those of neighbouring keyframes (B eq. 5), `frames` the numbers of the scan's frames that became
    keyframes."""

    name: str
    keyframes: int
    features_per_keyframe: float
    similarity_mean: float
    similarity_variance: float
    map_mb: float
    pictures_mb: float
    kb_per_keyframe: float
    build_s: float
    summary: ErrorSummary | None
    outcomes: tuple[QueryOutcome, ...]
    frames: tuple[int, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def measure_rule(
    name: str,
    source: FrameSource,
    options: BuildOptions,
    queries: Sequence[Query],
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    pipeline: Pipeline = "default",
) -> RuleFigures:
    """Build the map of a scan by the options' rule and locate the queries in it."""
    started = time.perf_counter()
    built = build_map(source, options, models, executor, progress)
    build_s = time.perf_counter() - started
    outcomes = locate_all(open_pipeline(pipeline, built, models), built.world_from_scan, queries, progress)
    similarities = neighbour_similarities(built.artifact, models.extractor(options.features))
    map_bytes = _map_bytes(built)
    numbers = {frame.name: number for number, frame in enumerate(source.frames)}
    pictures = [path.stat().st_size for frame in built.keyframes for path in (frame.color, frame.depth)]
    return RuleFigures(
        name=name,
        keyframes=built.artifact.keyframe_count,
        features_per_keyframe=round(built.artifact.feature_count / built.artifact.keyframe_count, 1),
        similarity_mean=round(float(np.mean(similarities)), 4),
        similarity_variance=round(float(np.var(similarities)), 5),
        map_mb=round(map_bytes / 1e6, 2),
        pictures_mb=round(sum(pictures) / 1e6, 2) if options.store_images else 0.0,
        kb_per_keyframe=round(largest_keyframe_bytes(built) / 1e3, 1),
        build_s=round(build_s, 1),
        summary=summarize(outcomes) if outcomes else None,
        outcomes=tuple(outcomes),
        frames=tuple(numbers[frame.name] for frame in built.keyframes),
    )


def locate_all(
    localizer: FrameLocalizer, world_from_scan: Pose, queries: Sequence[Query], progress: Progress
) -> list[QueryOutcome]:
    """Locate every query and compare with its true pose."""
    outcomes = []
    for done, query in enumerate(queries):
        progress.report("locate", done, len(queries))
        rgb = query.read()
        started = time.perf_counter()
        found = localizer.localize(rgb, query.camera)
        milliseconds = 1e3 * (time.perf_counter() - started)
        truth = world_from_scan @ query.scan_from_camera
        outcomes.append(outcome_of(query.name, found, truth, milliseconds))
    progress.report("locate", len(queries), len(queries))
    return outcomes


def neighbour_similarities(artifact: MapArtifact, extractor: LocalFeatureExtractor) -> list[float]:
    """Return the similarity (k - 1,) of each keyframe of a map to the one before it."""
    units = [
        to_unit_vectors(artifact.arrays.descriptors[artifact.rows(i)], extractor.binary)
        for i in range(artifact.keyframe_count)
    ]
    pairs = itertools.pairwise(units)
    return [content_similarity(a, b, extractor.ratio, extractor.binary) for a, b in pairs] or [1.0]


def largest_keyframe_bytes(built: BuiltMap) -> int:
    """Return what the largest keyframe of a map takes, its global descriptor included."""
    arrays = built.artifact.arrays
    features = [
        np.asarray(each)
        for each in (arrays.keypoints_px, arrays.points_in_world, arrays.point_sigma_m, arrays.descriptors)
    ]
    each = sum(int(array.nbytes) for array in features) / max(built.artifact.feature_count, 1)
    own = (_map_bytes(built) - each * built.artifact.feature_count) / built.artifact.keyframe_count
    return round(float(np.diff(arrays.offsets).max()) * each + own)


def _map_bytes(built: BuiltMap) -> int:
    arrays = built.artifact.arrays
    packed = sum(int(getattr(arrays, name).nbytes) for name in type(arrays).__slots__)
    return int(packed + built.index.descriptors.nbytes)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """Keyframes by eq. 6 with one pair of limits, and the similarity of neighbours among them."""

    alpha: float
    beta: float
    keyframes: int
    mean: float
    variance: float


def sweep_content(
    frames: Sequence[FrameContent], extractor: LocalFeatureExtractor, combine: ContentRule
) -> list[SweepRow]:
    """Return the paper's tables 3-4 and its figure 6 for a scan: all pairs of limits, other settings as given."""
    units = [to_unit_vectors(frame.descriptors, extractor.binary) for frame in frames]
    rows = []
    for alpha in ALPHAS:
        for step in BETA_STEPS:
            rule = ContentRule(alpha, round(alpha - step, 3), combine.combine, combine.seen, combine.steady)
            chosen = ContentSelector(rule, extractor.ratio, extractor.binary).select(frames)
            alike = [
                content_similarity(units[a], units[b], extractor.ratio, extractor.binary)
                for a, b in itertools.pairwise(chosen)
            ] or [1.0]
            mean, variance = float(np.mean(alike)), float(np.var(alike))
            rows.append(SweepRow(alpha, rule.beta, len(chosen), round(mean, 4), round(variance, 5)))
    return rows


def suggest(rows: Sequence[SweepRow], neighbours: float) -> SweepRow | None:
    """Return the pair of limits for a scene whose frames have that similarity to the one before them, on average.

    Of those that leave neighbours enough in common the one with few keyframes and little variance, each relative
    to the table's mean, as the paper weighs them; where none does, the one that leaves most. None where the
    frames themselves are less alike than a limit: the scan is no video, and what a frame left out shows is lost.
    """
    if neighbours < max(ALPHAS):
        return None
    enough = [row for row in rows if row.mean >= WANTED_SHARE * neighbours]
    if not enough:
        return max(rows, key=lambda row: (row.mean, -row.keyframes))
    count = float(np.mean([row.keyframes for row in rows]))
    variance = max(float(np.mean([row.variance for row in rows])), 1e-12)
    return min(enough, key=lambda row: row.keyframes / count + row.variance / variance)


def frame_similarity(frames: Sequence[FrameContent], extractor: LocalFeatureExtractor) -> float:
    """Return the mean similarity of a scan's frames to the one before them (B eq. 5)."""
    units = [to_unit_vectors(frame.descriptors, extractor.binary) for frame in frames]
    pairs = itertools.pairwise(units)
    return float(
        np.mean([content_similarity(a, b, extractor.ratio, extractor.binary) for a, b in pairs] or [1.0])
    )
