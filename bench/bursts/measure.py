"""Single frames, and bursts that begin with them, asked of one map with and without their motion."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from app.engine.progress import Progress
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.several.frame import GivenFrame
from app.engine.query.several.localize import localize_several
from app.errors import InvalidInputError
from app.geometry.se3 import Pose
from app.importers.frames import Frame
from app.vision.images import decode_image
from bench.bursts.frames import bursts, noisy_motion
from bench.evaluation.dataset import Split
from bench.evaluation.degrade import Degraded
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import QueryOutcome, summarize
from bench.evaluation.run import EvaluatedMap, Evaluation, median_stages
from bench.evaluation.variations import Variation


@dataclass(frozen=True, slots=True)
class BurstPlan:
    """How many frames a burst has, and how far apart they are."""

    count: int
    apart_s: float

    @property
    def names(self) -> tuple[str, str, str]:
        """What is compared: the first frame alone, all with their motion, all without it."""
        return "1 frame", f"{self.count} frames", f"{self.count} frames, no motion"


def evaluate_bursts(
    built: EvaluatedMap, split: Split, plan: BurstPlan, progress: Progress, variation: Variation
) -> list[Evaluation]:
    """Locate the first frame of every burst alone, and by the whole burst; the motion is the truth's with an error."""
    localizer = built.localizer
    if not isinstance(localizer, Localizer):
        raise InvalidInputError("--burst is for the default pipeline.")
    chosen = bursts(split.queries, split.unmapped, plan.count, plan.apart_s)
    ways = _ways(localizer, variation)
    if not variation.camera_given:
        # A motion needs the intrinsics.
        ways = [ways[0], ways[2]]
    names = [plan.names[0], *([plan.names[1]] if variation.camera_given else []), plan.names[2]]
    outcomes: list[list[QueryOutcome]] = [[] for _ in ways]
    timings: list[list[dict[str, float]]] = [[] for _ in ways]
    for done, burst in enumerate(chosen):
        progress.report(f"locate bursts {variation.name}", done, len(chosen))
        frames, truths = _asked(built, split, burst, done, variation)
        for way, outcome, timing in zip(ways, outcomes, timings, strict=True):
            started = time.perf_counter()
            found = way(frames, truths)
            milliseconds = 1e3 * (time.perf_counter() - started)
            outcome.append(outcome_of(burst[0].name, found, truths[0], milliseconds))
            if found.world_from_camera is not None:
                timing.append(found.timings_ms)
    progress.report(f"locate bursts {variation.name}", len(chosen), len(chosen))
    return [
        Evaluation(
            map=built.figures,
            variation=f"{variation.name}, {name}",
            summary=summarize(outcome),
            stages_ms=median_stages(timing),
            outcomes=tuple(outcome),
        )
        for name, outcome, timing in zip(names, outcomes, timings, strict=True)
    ]


Way = Callable[[Sequence[Degraded], Sequence[Pose]], Localization]


def _ways(localizer: Localizer, variation: Variation) -> list[Way]:
    """Return how the frames are asked: the first alone, all with their motion, all without it."""

    def alone(frames: Sequence[Degraded], _: Sequence[Pose]) -> Localization:
        return localizer.localize(frames[0].rgb, frames[0].camera if variation.camera_given else None)

    def given(frames: Sequence[Degraded], motions: Sequence[Pose | None]) -> Localization:
        return localize_several(
            localizer,
            [
                GivenFrame(
                    rgb=frame.rgb,
                    camera=frame.camera if variation.camera_given else None,
                    first_from_camera=motion,
                )
                for frame, motion in zip(frames, motions, strict=True)
            ],
        )

    def with_motion(frames: Sequence[Degraded], truths: Sequence[Pose]) -> Localization:
        motions = [truths[0].inverse() @ truth for truth in truths]
        later = [noisy_motion(motion, f"{k} {motion.translation}") for k, motion in enumerate(motions) if k]
        return given(frames, [Pose.identity(), *later])

    def without_motion(frames: Sequence[Degraded], _: Sequence[Pose]) -> Localization:
        return given(frames, [None] * len(frames))

    return [alone, with_motion, without_motion]


def _asked(
    built: EvaluatedMap, split: Split, burst: Sequence[Frame], number: int, variation: Variation
) -> tuple[list[Degraded], list[Pose]]:
    """Return the frames as they are asked, and their true `world_from_camera`."""
    frames = [
        variation.apply(
            number, frame.name, decode_image(split.database.color_bytes(frame)), split.database.camera
        )
        for frame in burst
    ]
    truths = [
        built.world_from_scan @ frame.scan_from_camera @ asked.original_from_degraded
        for frame, asked in zip(burst, frames, strict=True)
    ]
    return frames, truths
