"""Single frames, and bursts that begin with them, asked of one map with and without their motion."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from app.engine.progress import Progress
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.several.frame import GivenFrame, as_given, ask_alone
from app.engine.query.several.with_motion import locate_with_motion
from app.engine.query.several.without_motion import locate_without_motion
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
    """Locate the first frame of every burst alone, and by the whole burst; the motion is the truth's with an error.

    A motion needs the intrinsics: without a camera there is none.
    """
    localizer = built.localizer
    if not isinstance(localizer, Localizer):
        raise InvalidInputError("--burst is for the default pipeline.")
    chosen = bursts(split.queries, split.unmapped, plan.count, plan.apart_s)
    names = [name for name in plan.names if variation.camera_given or name != plan.names[1]]
    outcomes: dict[str, list[QueryOutcome]] = {name: [] for name in names}
    timings: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for done, burst in enumerate(chosen):
        progress.report(f"locate bursts {variation.name}", done, len(chosen))
        frames, truths = _asked(built, split, burst, done, variation)
        found_by = _located(localizer, plan, frames, truths, variation)
        for name, (found, milliseconds) in found_by.items():
            outcomes[name].append(outcome_of(burst[0].name, found, truths[0], milliseconds))
            if found.world_from_camera is not None:
                timings[name].append(found.timings_ms)
    progress.report(f"locate bursts {variation.name}", len(chosen), len(chosen))
    return [
        Evaluation(
            map=built.figures,
            variation=f"{variation.name}, {name}",
            summary=summarize(outcomes[name]),
            stages_ms=median_stages(timings[name]),
            outcomes=tuple(outcomes[name]),
        )
        for name in names
    ]


def _located(
    localizer: Localizer,
    plan: BurstPlan,
    frames: Sequence[Degraded],
    truths: Sequence[Pose],
    variation: Variation,
) -> dict[str, tuple[Localization, float]]:
    """Return what each way leads to, and its milliseconds. What they have in common, asking each frame alone, is done
    once, and counts for each."""
    clock = _Clock()
    given = [_given(frame, motion, variation) for frame, motion in zip(frames, _motions(truths), strict=True)]
    first = ask_alone(localizer, given[0])
    first_ms = clock.lap_ms()
    asked = [first, *(ask_alone(localizer, frame) for frame in given[1:])]
    all_ms = first_ms + clock.lap_ms()
    alone, with_motion, without_motion = plan.names
    found = {alone: (as_given(first, first.found, first.world_from_given), first_ms)}
    if variation.camera_given:
        moved = locate_with_motion(localizer, asked)
        found[with_motion] = moved, all_ms + clock.lap_ms()
        if first.found.world_from_camera is None:
            # The motion led to matches of frame 0 that are not known without it.
            asked = [ask_alone(localizer, given[0]), *asked[1:]]
            clock.lap_ms()
    unmoved = locate_without_motion(localizer, asked)
    found[without_motion] = unmoved, all_ms + clock.lap_ms()
    return found


class _Clock:
    """Milliseconds from one lap to the next."""

    def __init__(self) -> None:
        self._since_s = time.perf_counter()

    def lap_ms(self) -> float:
        before, self._since_s = self._since_s, time.perf_counter()
        return 1e3 * (self._since_s - before)


def _given(frame: Degraded, motion: Pose, variation: Variation) -> GivenFrame:
    camera = frame.camera if variation.camera_given else None
    return GivenFrame(rgb=frame.rgb, camera=camera, first_from_camera=motion)


def _motions(truths: Sequence[Pose]) -> list[Pose]:
    """Return the motion of each frame with the error of a phone's odometry."""
    exact = [truths[0].inverse() @ truth for truth in truths]
    later = [noisy_motion(motion, f"{k} {motion.translation}") for k, motion in enumerate(exact) if k]
    return [Pose.identity(), *later]


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
