"""The RGB-D paper's protocol: the keyframes of a walk are the database, all its other frames are queries (A 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from app.engine.mapping.build_map import scan_placement
from app.engine.mapping.calibrate import calibrate
from app.engine.mapping.keyframe_rule import KeyframeRule
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.select_keyframes import select_keyframes
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.errors import InvalidInputError
from app.importers.frames import Scan
from app.vision.keyframes import PoseThresholds
from bench.evaluation.dataset import Split


@dataclass(frozen=True, slots=True)
class KeyframeSplit:
    """A walk split by its keyframes; `options` build the map of exactly these keyframes, `thresholds` are those that
    the pose rule selected them by, None for another rule."""

    split: Split
    options: BuildOptions
    thresholds: PoseThresholds | None


def split_by_keyframes(
    scan: Scan, options: BuildOptions, models: VisionModels, executor: Executor, progress: Progress
) -> KeyframeSplit:
    """Select the keyframes by the options' rule; all other frames become queries.

    The map is built from the keyframes alone, so that no query contributes to it. Raises `InvalidInputError` when
    every frame is a keyframe.
    """
    rule = options.keyframes
    if rule.calibrated:
        thresholds = calibrate(scan, options, models, executor, progress).thresholds
        rule = replace(rule, thresholds=thresholds)
    placed = scan_placement(options, scan)
    poses = [placed @ frame.scan_from_camera for frame in scan.frames]
    extractor = models.extractor(options.features)
    rows = select_keyframes(scan, poses, rule, extractor, executor, progress)
    split = _split(scan, rows)
    every = KeyframeRule(rule="interval", every=1, thresholds=rule.thresholds)
    return KeyframeSplit(
        split,
        replace(options, keyframes=every),
        rule.thresholds if rule.rule == "pose" else None,
    )


def _split(scan: Scan, rows: Sequence[int]) -> Split:
    chosen = set(rows)
    queries = tuple(frame for row, frame in enumerate(scan.frames) if row not in chosen)
    if not queries:
        raise InvalidInputError("Every frame of the scan is a keyframe by this rule: no query is left.")
    return Split(replace(scan, frames=tuple(scan.frames[row] for row in rows)), queries, queries)
