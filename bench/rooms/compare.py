"""Every pipeline on every split of a room, with the queries as they are and made worse."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.options import parse_build_options
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.engine.query.settings import LocalizerSettings
from app.importers.frames import Frame
from app.vision.images import decode_image
from bench.baselines.plain import PLAIN_NAMES, PlainName, PlainPipeline
from bench.evaluation.dataset import Split
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import GROSS_M, RIGHT_DEG, RIGHT_M, QueryOutcome, pose_error
from bench.evaluation.variations import Variation
from bench.rooms.rooms import Room, RoomSplit, open_split

OURS = "roomfix"
ONE_LOOK = "roomfix, one look"
PIPELINES = (OURS, ONE_LOOK, *(f"plain {name}" for name in PLAIN_NAMES))

# Room, split, pipeline and variation: what one result is of.
ResultKey = tuple[str, str, str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomResult:
    """What one pipeline made of one variation of a split's queries."""

    room: str
    kind: str
    split: str
    pipeline: str
    variation: str
    keyframes: int
    outcomes: tuple[QueryOutcome, ...]

    @property
    def key(self) -> ResultKey:
        """What the result is of."""
        return self.room, self.split, self.pipeline, self.variation

    @property
    def located(self) -> int:
        """Queries that were located."""
        return len(self.outcomes) - self.refused

    @property
    def right(self) -> int:
        """Queries located within 0.5 m and 5 degrees."""
        return sum(outcome.right for outcome in self.outcomes)

    @property
    def wrong(self) -> int:
        """Queries located more than 0.5 m off."""
        return sum(outcome.located and outcome.position_m > GROSS_M for outcome in self.outcomes)

    @property
    def within_5cm(self) -> int:
        """Queries located within 5 cm and 5 degrees."""
        return sum(o.located and o.position_m < 0.05 and o.orientation_deg < RIGHT_DEG for o in self.outcomes)

    @property
    def refused(self) -> int:
        """Queries that were not located."""
        return sum(not outcome.located for outcome in self.outcomes)

    @property
    def right_refused(self) -> int:
        """Queries that were not located though the pose that was judged was right."""
        return sum(not o.located and candidate_is_right(o) for o in self.outcomes)

    @property
    def median_cm(self) -> float | None:
        """The median error of the located queries in centimetres."""
        errors = [outcome.position_m for outcome in self.outcomes if outcome.located]
        return round(100 * float(np.median(errors)), 2) if errors else None

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON, as the commands that read evaluations take it."""
        return {
            "name": f"{self.room} {self.split} {self.pipeline}",
            "features": self.pipeline,
            "room": self.room,
            "kind": self.kind,
            "split": self.split,
            "variation": self.variation,
            "keyframes": self.keyframes,
            "outcomes": [outcome.as_dict() for outcome in self.outcomes],
        }

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> RoomResult:
        """Return the result of `as_dict`."""
        return RoomResult(
            room=values["room"],
            kind=values["kind"],
            split=values["split"],
            pipeline=values["features"],
            variation=values["variation"],
            keyframes=values["keyframes"],
            outcomes=tuple(QueryOutcome.from_dict(each) for each in values["outcomes"]),
        )


def candidate_is_right(outcome: QueryOutcome) -> bool:
    """Return whether the pose that was judged, trusted or not, is within 0.5 m and 5 degrees."""
    if outcome.candidate_m is None or outcome.candidate_deg is None:
        return False
    return outcome.candidate_m < RIGHT_M and outcome.candidate_deg < RIGHT_DEG


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What is compared: pipelines, variations of the queries, and at most `queries` of a split, evenly spread (0: all).

    Results whose key is `known` are left out.
    """

    pipelines: Sequence[str]
    variations: Sequence[Variation]
    queries: int = 0
    known: Collection[ResultKey] = ()

    def keys(self, room: Room, split: RoomSplit) -> list[ResultKey]:
        """Return what is to be measured of a split."""
        every = [(room.folder, split.name, p, v.name) for p in self.pipelines for v in self.variations]
        return [key for key in every if key not in self.known]


def compare_room(
    data: Path,
    room: Room,
    wanted: Comparison,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> Iterator[RoomResult]:
    """Yield the results of every split, pipeline and variation; the map of a split is built once."""
    for split in room.splits:
        if wanted.keys(room, split):
            frames = open_split(data, room, split)
            frames = replace(frames, queries=_spread(frames.queries, wanted.queries))
            yield from _compare_split(frames, room, split, wanted, models, executor, progress)


def _spread(queries: Sequence[Frame], count: int) -> tuple[Frame, ...]:
    """Return `count` of the queries, evenly spread, the first and the last among them; all for 0."""
    if count == 0 or count >= len(queries):
        return tuple(queries)
    return tuple(queries[row] for row in np.linspace(0, len(queries) - 1, count).round().astype(int))


def _compare_split(
    frames: Split,
    room: Room,
    split: RoomSplit,
    wanted: Comparison,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> Iterator[RoomResult]:
    options = parse_build_options({**room.options, "second_features": True})
    built = build_map(frames.database, options, models, executor, progress)
    keys = wanted.keys(room, split)
    for pipeline in dict.fromkeys(key[2] for key in keys):
        locate = _locator(pipeline, frames, built, models)
        for variation in wanted.variations:
            if (room.folder, split.name, pipeline, variation.name) in keys:
                yield RoomResult(
                    room=room.folder,
                    kind=split.kind,
                    split=split.name,
                    pipeline=pipeline,
                    variation=variation.name,
                    keyframes=built.artifact.keyframe_count,
                    outcomes=tuple(_outcomes(frames, built, variation, locate, progress)),
                )


def _locator(
    pipeline: str, frames: Split, built: BuiltMap, models: VisionModels
) -> Localizer | PlainPipeline:
    if pipeline in (OURS, ONE_LOOK):
        settings = LocalizerSettings(second_look=pipeline == OURS)
        return Localizer.of(built.artifact, built.index, models, settings)
    name: PlainName = next(each for each in PLAIN_NAMES if pipeline == f"plain {each}")
    return PlainPipeline(name, frames.database, built.keyframes, built.world_from_scan, models)


def _outcomes(
    frames: Split,
    built: BuiltMap,
    variation: Variation,
    locate: Localizer | PlainPipeline,
    progress: Progress,
) -> Iterator[QueryOutcome]:
    for number, frame in enumerate(frames.queries):
        progress.report(f"locate {variation.name}", number, len(frames.queries))
        rgb = decode_image(frames.database.color_bytes(frame))
        asked = variation.apply(number, frame.name, rgb, frames.database.camera)
        truth = built.world_from_scan @ frame.scan_from_camera @ asked.original_from_degraded
        started = time.perf_counter()
        if isinstance(locate, Localizer):
            found = locate.localize(asked.rgb, asked.camera if variation.camera_given else None)
            yield outcome_of(frame.name, found, truth, 1e3 * (time.perf_counter() - started))
            continue
        pose = locate.localize(asked.rgb, asked.camera)
        milliseconds = 1e3 * (time.perf_counter() - started)
        position_m, orientation_deg = (float("inf"), 180.0) if pose is None else pose_error(pose, truth)
        yield QueryOutcome(
            name=frame.name,
            located=pose is not None,
            position_m=position_m,
            orientation_deg=orientation_deg,
            reason=None if pose is not None else "too_few_inliers",
            inliers=0,
            confidence=0.0,
            milliseconds=milliseconds,
        )
